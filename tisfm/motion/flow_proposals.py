"""Motions that coarse to fine has lost: looked for where the flow is found wanting.

On a coarse level a thing that moves farther than it is large cannot be told from what is around
it, and finer levels only improve what they start from. So once, on a level where most things can
be seen, windows of both frames are compared along the flow. Where they do not look alike,
displacements from all around are tried, both ways round, and the images decide pixel by pixel. The
minimisation goes on from there.
"""

import cv2
import numpy as np

from tisfm.kernels.rigid.flow_search import carry
from tisfm.kernels.rigid.patch_match import RADIUS, UNSEEN
from tisfm.motion.matched_windows import FEWEST, Windows, WindowSearch, resized
from tisfm.solver.coarse_to_fine import Amendment, Problem
from tisfm.solver.data_term import Constancy
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.smoothness import mean_step
from tisfm.solver.unknowns import Unknowns

MOST = 2**18  # pixels of the level that is amended: a coarser one serves larger frames
JUDGED = 2**14  # pixels, at least, of the level that the flow is judged on
WANTING = 0.5  # a cost that no right flow has, but where something hides the pixel
PLAIN = 6.0  # times the variance of the noise: windows that vary by more are judged
# Of the pixels that are wanting: up to 0.06 where motion is found, 0.11 and more where much of it
# is lost. If fewer are, only what moves farther than it is large is looked for.
MANY = 0.08
AROUND = 7  # px of the level judged: the side of the window that is searched around such a pixel
COST, AGREEMENT = 0.5, 2.0  # what is believed costs less, is found as near (px) the other way round
ISLAND, SIXTEENTHS = 100, 16  # and belongs to as many pixels within 1 px of each other
STRAY = 30  # px: the least area of what moves farther than it is large
ELSEWHERE, BETTER = 1.0, 0.05  # px apart, and by how much less a displacement costs that is new
EVIDENCE, MOST_OFF = 5, 5.0  # px: residuals are means over it, each of so many deviations at most
CARRIED = 0.3  # deviations: the least by which they fall where a displacement is a neighbour's
CARRIED_COST = 0.3  # of what was there before
PASSES = 6  # of carrying, along rows and columns
EDGE = 0.33  # of the mean step: a step of grey levels over which it is as far as over a pixel


def proposals(pyramid: ImagePyramid, problem: Problem) -> Amendment | None:
    """Return what amends a flow on its way from coarse to fine, None where it would not pay.

    Parameters
    ----------
    pyramid : ImagePyramid
    problem : Problem
        Of free motion, whose first two unknowns move the image alike everywhere.
    """
    if pyramid.levels == 1:  # a single scale is what was asked for
        return None
    levels = range(pyramid.last, pyramid.levels)
    level = next((k for k in levels if pyramid.frames0[k].size <= MOST), levels[-1])
    height, width = pyramid.frames0[level].shape
    if height * width < FEWEST or min(height, width) <= 2 * RADIUS:
        return None

    def amend(unknowns: Unknowns) -> bool:
        flow = cv2.merge(list(unknowns.flow()))
        better = better_flow(pyramid, level, problem.constancy, flow)
        if better is None:
            return False
        rho = unknowns.images()
        rho[:2] += cv2.split(better - flow)
        unknowns.set_images(rho)
        return True

    return Amendment(level=level, apply=amend)


def better_flow(
    pyramid: ImagePyramid, level: int, constancy: Constancy, flow: np.ndarray
) -> np.ndarray | None:
    """Return a flow that the images of a level confirm where they contradict another.

    Parameters
    ----------
    pyramid : ImagePyramid
    level : int
    constancy : Constancy
        Its weights are those of the evidence.
    flow : (h, w, 2) float32
        px/frame of the level.

    Returns
    -------
    (h, w, 2) float32 or None
        None where nothing better was found.

    References
    ----------
    Bailer, Taetz, Stricker, "Flow Fields: dense correspondence fields for highly accurate large
    displacement optical flow estimation", ICCV 2015, doi 10.1109/ICCV.2015.457; Revaud,
    Weinzaepfel, Harchaoui, Schmid, "EpicFlow: edge-preserving interpolation of correspondences for
    optical flow", CVPR 2015, doi 10.1109/CVPR.2015.7298720 (geodesic distance).
    """
    if not np.isfinite(flow).all():
        return None
    search = WindowSearch(pyramid, level)
    wanting = _wanting(search, flow)
    share = float(wanting.mean())
    if not share:
        return None
    sought = None
    if share < MANY:
        sought = cv2.dilate(wanting.astype(np.uint8), np.ones((AROUND, AROUND), np.uint8)) > 0
    windows = search.windows[-1]
    before, there = windows.scored(flow), search.forward(flow, sought)
    new = _new(there, before)
    if sought is not None:
        new = _strays(new, there, flow)
    if not new.any():
        return None
    here = search.backward(None if sought is None else _landing(there, new))
    agreed = _agreeing(there, here)
    residual = _Residual(windows, constancy)
    new &= agreed & residual.falls(flow, there[..., :2], by=0.0)
    if sought is not None:
        new = _strays(new, there, flow)
    found = np.where(new[..., None], there[..., :2], flow)
    if sought is None:
        known = new | (agreed & ~_elsewhere(there, flow))
        found = _carried(windows, residual, found, known, before)
    return found if new.any() else None


def _wanting(search: WindowSearch, flow: np.ndarray) -> np.ndarray:
    """Return where the frames do not look alike along a flow, (h, w) bool of a coarser level."""
    large = [windows for windows in search.windows if windows.levels0.size >= JUDGED]
    windows = large[0] if large else search.windows[-1]
    cost = windows.scored(resized(flow, windows.shape), seen=PLAIN)[..., 2]
    return (cost > WANTING) & (cost < UNSEEN)


def _elsewhere(state: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return where a state has another displacement than a flow."""
    return np.hypot(*cv2.split(state[..., :2] - flow)) > ELSEWHERE


def _new(there: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return where a state is another than the one before, and looks more alike."""
    better = there[..., 2] < np.minimum(before[..., 2] - BETTER, COST)
    return better & (before[..., 2] < UNSEEN) & _elsewhere(there, before[..., :2])


def _strays(new: np.ndarray, there: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return those of the new pixels that move farther than they are large.

    Each of their areas, connected, has to move against all of the flow around it by more than the
    root of its size.
    """
    side = 2 * RADIUS + 1
    window = np.ones((side, side), np.uint8)
    beyond = np.maximum(
        cv2.erode(flow, window) - there[..., :2], there[..., :2] - cv2.dilate(flow, window)
    )
    away = np.hypot(*cv2.split(np.maximum(beyond, 0)))
    count, labels = cv2.connectedComponents(new.astype(np.uint8), connectivity=4)
    size = np.bincount(labels.ravel(), minlength=count)
    mean = np.bincount(labels.ravel(), away.ravel(), minlength=count) / np.maximum(size, 1)
    strays = (mean > np.sqrt(size)) & (size >= STRAY)
    strays[0] = False
    return strays[labels]


def _landing(there: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return where in frame 1 the new pixels go, and what is around, (h, w) bool."""
    mask = np.zeros(new.shape, np.uint8)
    row, column, _ = _target(there)
    mask[row[new], column[new]] = 1
    return cv2.dilate(mask, np.ones((AROUND, AROUND), np.uint8)) > 0


def _target(there: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest row and column that each pixel goes to, and whether there are such."""
    height, width = there.shape[:2]
    column = np.rint(there[..., 0] + np.arange(width, dtype=np.float32))
    row = np.rint(there[..., 1] + np.arange(height, dtype=np.float32)[:, None])
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = column.clip(0, width - 1), row.clip(0, height - 1)
    return row.astype(np.intp), column.astype(np.intp), inside


def _agreeing(there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return which displacements are found the other way round too, and by many neighbours."""
    row, column, inside = _target(there)
    back = here[row, column]
    apart = np.hypot(*cv2.split(there[..., :2] + back[..., :2]))
    agreed = inside & (apart < AGREEMENT) & (there[..., 2] < COST) & (back[..., 2] < UNSEEN)
    agreed &= back[..., 3] > 0
    for component in cv2.split(there[..., :2]):
        fixed = SIXTEENTHS * (component - component.min()) + 1
        fixed = np.where(agreed, fixed, 0).clip(0, np.iinfo(np.int16).max).astype(np.int16)
        cv2.filterSpeckles(fixed, 0, ISLAND, SIXTEENTHS)
        agreed &= fixed > 0
    return agreed


def _carried(
    windows: Windows,
    residual: "_Residual",
    found: np.ndarray,
    known: np.ndarray,
    before: np.ndarray,
) -> np.ndarray:
    """Return a flow with what is known carried to where the images confirm it."""
    distance = np.where(known, 0, np.float32(found.size)).astype(np.float32)
    nearest = np.zeros((*windows.shape, 4), np.float32)
    nearest[..., :2], nearest[..., 3] = found, 1
    for _ in range(PASSES):
        carry(windows.levels0, distance, nearest, edge=EDGE * mean_step(windows.levels0))
    windows.search().score(nearest)
    lower = nearest[..., 2] < before[..., 2] - BETTER
    taken = ~known & lower & (before[..., 2] > CARRIED_COST) & (before[..., 2] < UNSEEN)
    taken &= residual.falls(found, nearest[..., :2], by=CARRIED)
    return np.where(taken[..., None], nearest[..., :2], found)


class _Residual:
    """By how much frame 1 is off along a flow, in deviations of the noise."""

    def __init__(self, windows: Windows, constancy: Constancy) -> None:
        weights = (constancy.brightness, constancy.gradient, constancy.gradient)
        self._weights = [weight / sum(weights) for weight in weights]
        self._noise = windows.noise
        self._frames0, self._frames1 = map(_with_slopes, (windows.levels0, windows.levels1))

    def falls(self, before: np.ndarray, after: np.ndarray, *, by: float) -> np.ndarray:
        """Return where it is lower by more than `by` along one flow, (h, w, 2), than another."""
        return self._along(after) < self._along(before) - by

    def _along(self, flow: np.ndarray) -> np.ndarray:
        height, width = flow.shape[:2]
        x = flow[..., 0] + np.arange(width, dtype=np.float32)
        y = flow[..., 1] + np.arange(height, dtype=np.float32)[:, None]
        total = np.zeros((height, width), np.float32)
        for weight, frame0, frame1 in zip(self._weights, self._frames0, self._frames1, strict=True):
            moved = cv2.remap(frame1, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            total += weight * np.minimum(np.abs(moved - frame0) / self._noise, MOST_OFF)
        mean: np.ndarray = cv2.blur(total, (EVIDENCE, EVIDENCE))
        return mean


def _with_slopes(levels: np.ndarray) -> list[np.ndarray]:
    """Return a frame, over the root of 2, as its difference of two has that noise; and slopes."""
    slope = np.array([[-0.5, 0, 0.5]], np.float32)
    across, down = (cv2.filter2D(levels, cv2.CV_32F, kernel) for kernel in (slope, slope.T))
    return [levels / np.float32(2**0.5), across, down]
