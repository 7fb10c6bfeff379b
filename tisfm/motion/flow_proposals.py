"""Motions that coarse to fine has lost: looked for where the flow is found wanting.

On a coarse level a thing that moves far for its size cannot be told from what is around it, and
finer levels only improve what they start from. So once, on a level where most things can be seen,
windows of both frames are compared along the flow. Where they do not look alike, displacements
from all around are tried, both ways round, and the images decide pixel by pixel. The minimisation
goes on from there.
"""

import cv2
import numpy as np

from tisfm.kernels.rigid.flow_search import carry
from tisfm.kernels.rigid.windows import RADIUS, UNSEEN
from tisfm.motion.fast_objects import FastObjects
from tisfm.motion.matched_windows import FEWEST, SEEN, Windows, WindowSearch, masked, resized
from tisfm.motion.residual_comparison import ResidualComparison
from tisfm.solver.coarse_to_fine import Problem
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.smoothness import mean_step
from tisfm.solver.unknowns import Unknowns

MOST = 2**18  # pixels of the level that is amended: a coarser one serves larger frames
LONGEST = 2**15 - 2  # px: OpenCV samples no longer frames
JUDGED = 2**14  # pixels, at least, of the level that the flow is judged on
WANTING = 0.5  # a cost that no right flow has, but where something hides the pixel
RIGHT = 0.3  # a cost that is more than that of most right flows
PLAIN = 6.0  # times the variance of the noise: windows that vary by more are judged
# Of the pixels that are wanting: up to 0.06 where motion is found, 0.11 and more where much of it
# is lost. If fewer are, only things that move far for their size are looked for.
MANY = 0.08
AROUND = 7  # px of the level judged: the side of the window that is searched around such a pixel
COST, AGREEMENT = 0.5, 2.0  # what is believed costs less, is found as near (px) the other way round
ISLAND, SIXTEENTHS = 100, 16  # and belongs to as many pixels within 1 px of each other
# Of the pixels that are not bare: frames of one scene have 0.6 and more that are found so, others
# less than 0.05.
ENOUGH = 0.2
# Of things that move far for their size, on the level judged and on the one amended: the least
# area, px, and the least way over the root of it. On the first, areas are larger by their windows.
AREA_SEEMING, AREA = 24, 50
FARTHER_SEEMING, FARTHER = 0.25, 0.5
SUPPORT = 10  # pixels of such an area, of the level judged, that the images clearly bear out
ELSEWHERE, BETTER = 1.0, 0.05  # px apart, and by how much less a displacement costs that is new
BEYOND = np.float32(LONGEST)  # px: no flow has more
EVIDENCE = 5  # px: the side of the square whose residuals decide
VOUCHED = 0.25  # of its area: as many pixels as have to be found both ways round
# Least mean square of the slope along any direction, over the variance of the noise, of an area
# that moves on its own. Noise alone has ½; correct areas had 0.97 and more.
STRIPED = 0.8
# Of the longer side: the largest motion of such an area. Correct areas moved by at most 0.35, the
# limit of the search (`tisfm.motion.matched_windows.LARGEST`), and wrong ones by 0.5.
FARTHEST = 0.4
MANY_TRIED = 2**15  # draws in each round, where something seems to be
CLEARLY = 0.6  # deviations: the least by which residuals fall for a thing that moves on its own
CARRIED = 0.3  # deviations: the least by which they fall where a displacement is a neighbour's
CARRIED_COST = 0.3  # of what was there before
STEEPEST = 0.5  # px/frame per px: a flow that changes faster than by turns and zooms breaks off
PASSES = 6  # of carrying, along rows and columns
EDGE = 0.33  # of the mean step: a step of grey levels over which it is as far as over a pixel


def proposals(pyramid: ImagePyramid, problem: Problem) -> "Proposals | None":
    """Return what amends a flow on its way from coarse to fine, None where it would not pay.

    Parameters
    ----------
    pyramid : ImagePyramid
    problem : Problem
        Of free motion, whose first two unknowns move the image alike everywhere.
    """
    if pyramid.levels == 1 or pyramid.frames0[-1].size > MOST:  # few scales are what was asked for
        return None
    levels = range(pyramid.last, pyramid.levels)
    level = next(k for k in levels if pyramid.frames0[k].size <= MOST)
    height, width = pyramid.frames0[level].shape
    if height * width < FEWEST or min(height, width) <= 2 * RADIUS or max(pyramid.shape) > LONGEST:
        return None
    return Proposals(pyramid, problem, level)


class Proposals:
    """An `Amendment`: motions that the images of a level bear out where they contradict the flow.

    References
    ----------
    Bailer, Taetz, Stricker, "Flow Fields: dense correspondence fields for highly accurate large
    displacement optical flow estimation", ICCV 2015, doi 10.1109/ICCV.2015.457; Revaud,
    Weinzaepfel, Harchaoui, Schmid, "EpicFlow: edge-preserving interpolation of correspondences for
    optical flow", CVPR 2015, doi 10.1109/CVPR.2015.7298720 (geodesic distance).
    """

    def __init__(self, pyramid: ImagePyramid, problem: Problem, level: int) -> None:
        self.level = level
        self._search = WindowSearch(pyramid, level)
        large = [k for k in self._search.levels if pyramid.frames0[k].size >= JUDGED]
        self._judged = large[0] if large else level
        self._scale = pyramid.scales[level]
        self._problem = problem
        self._things: FastObjects | None = None

    def apply(self, unknowns: Unknowns) -> bool:
        """Put in what is better than ρ̂ on its level, and return whether anything is."""
        flow = cv2.merge(list(unknowns.flow()))
        if not np.isfinite(flow).all():
            return False
        judged, wanting = self._judge(flow)
        better = flow
        if wanting.mean() >= MANY:
            found = self._all_over(flow)
            if found is None:
                return False
            if found is not flow:
                better = found
                judged, wanting = self._judge(better)
        better = self._with_things(better, judged, wanting)
        if better is flow:
            return False
        rho = unknowns.images()
        rho[:2] += cv2.split(better - flow)
        unknowns.set_images(rho)
        self.go_on(unknowns, self.level)
        return True

    def go_on(self, unknowns: Unknowns, level: int) -> None:
        """Keep apart, on the next finer level, what moves on its own."""
        if self._things is not None:
            self._things.set_apart(self._search.windows(level), unknowns)

    def _judge(self, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state of a flow on the level judged, and which pixels it leaves wanting."""
        windows = self._search.windows(self._judged)
        coarse = resized(flow, windows.shape, windows.scale / self._scale)
        judged = windows.scored(coarse, seen=PLAIN)
        return judged, (judged[..., 2] > WANTING) & (judged[..., 2] < UNSEEN)

    def _all_over(self, flow: np.ndarray) -> np.ndarray | None:
        """Return a better flow of frames whose motion was missed in large parts.

        None of frames that have too little in common.
        """
        search = self._search
        windows = search.windows(self.level)
        known = [(flow, windows.scale)]
        before, there = windows.scored(flow), search.forward(search.levels, known=known)
        agreed = _without_islands(there, _agreeing(there, search.backward(search.levels)))
        if np.count_nonzero(agreed) < ENOUGH * np.count_nonzero(before[..., 2] < UNSEEN):
            return None
        evidence = ResidualComparison(windows, self._problem.constancy)
        new = agreed & _new(there, before)
        new &= evidence.better(there[..., :2], flow, window=EVIDENCE)
        if not new.any():
            return flow
        found = np.where(new[..., None], there[..., :2], flow)
        known = new | (agreed & ~_elsewhere(there, flow))
        return _carried(windows, evidence, found, known, before)

    def _with_things(self, flow: np.ndarray, judged: np.ndarray, wanting: np.ndarray) -> np.ndarray:
        """Return a flow with that of things that move far for their size."""
        sought = _unexplained(judged, wanting)
        if not sought.any():
            return flow
        search = self._search
        windows, coarse = search.windows(self._judged), judged[..., :2]
        there = search.forward([self._judged], known=[(coarse, windows.scale)], sought=sought)
        new = _fast(_new(there, judged), there, judged, farther=FARTHER_SEEMING, least=AREA_SEEMING)
        if not new.any():
            return flow
        evidence = ResidualComparison(windows, self._problem.constancy)
        supported = evidence.better(there[..., :2], coarse, window=EVIDENCE, by=CLEARLY)
        new = _supported(new, supported)
        if not new.any():
            return flow
        # There may be some. They are looked for again where more can be seen, with more draws.
        found = there[..., :2], windows.scale
        windows, level = search.windows(self.level), [self.level]
        sought = masked(_around(new, 3), windows.shape)
        # Draws are made around what is known, and what was found may be wrong: first without it.
        there = search.forward(
            level, known=[(flow, windows.scale)], sought=sought, tried=MANY_TRIED
        )
        known = [(there[..., :2], windows.scale), found]
        there = search.forward(level, known=known, sought=sought, tried=0)
        evidence = ResidualComparison(windows, self._problem.constancy)
        before = windows.scored(flow, sought=_around(sought, 2 * RADIUS + 1))
        new = sought & _new(there, before)
        new &= evidence.better(there[..., :2], flow, window=EVIDENCE, by=CLEARLY)
        new = _fast(new, there, before, farther=FARTHER, least=AREA)
        if not new.any():
            return flow
        here = search.backward(
            [self.level],
            known=[(-flow, windows.scale), (_turned(there, new), windows.scale)],
            sought=_landing(there, new),
            tried=MANY_TRIED,
        )
        new = _vouched(new, there, _agreeing(there, here))
        new = _fast(new, there, before, farther=FARTHER, least=AREA)
        new = _unmistakable(new, there, before, windows)
        if not new.any():
            return flow
        self._things = FastObjects(new, self._problem)
        return np.where(new[..., None], there[..., :2], flow)


def _unexplained(judged: np.ndarray, wanting: np.ndarray) -> np.ndarray:
    """Return those of the wanting pixels that nothing seems to hide, (h, w) bool.

    They stay in the image, do not go where others go that look alike there, and are not scattered.
    """
    row, column, inside = _target(judged)
    right = inside & (judged[..., 2] < RIGHT)
    taken = np.zeros(wanting.shape, np.uint8)
    taken[row[right], column[right]] = 1
    square = np.ones((3, 3), np.uint8)
    free = cv2.dilate(taken, square)[row, column] == 0
    left = (wanting & inside & free).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(left, cv2.MORPH_OPEN, square)) > 0


def _elsewhere(state: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return where a state has another displacement than a flow."""
    return np.hypot(*cv2.split(state[..., :2] - flow)) > ELSEWHERE


def _new(there: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return where a state is another than the one before, and looks more alike."""
    better = there[..., 2] < np.minimum(before[..., 2] - BETTER, COST)
    return better & (before[..., 2] < UNSEEN) & _elsewhere(there, before[..., :2])


def _fast(
    new: np.ndarray, there: np.ndarray, before: np.ndarray, *, farther: float, least: int
) -> np.ndarray:
    """Return those of the new pixels that move far for their size.

    Each of their areas, connected, has to move against the flow by more than `farther` times the
    root of its size, which is `least` px or more: against its own before, and against that around
    it of what looks alike in both frames. On bare surfaces, flow says nothing.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(new.astype(np.uint8), connectivity=4)
    size = boxes[:, cv2.CC_STAT_AREA]
    large = size >= least
    large[0] = False
    if not large.any():
        return np.zeros_like(new)
    first, extent = boxes[large, :2], boxes[large, 2:4]
    left, top = np.maximum(first.min(axis=0) - RADIUS, 0)
    end, bottom = (first + extent).max(axis=0) + RADIUS
    part = np.s_[top:bottom, left:end]
    away = _beyond(there[part], before[part])
    mean = np.bincount(labels[part].ravel(), away.ravel(), minlength=count) / np.maximum(size, 1)
    return (large & (mean > farther * np.sqrt(size)))[labels]


def _beyond(there: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return how far displacements are from those of the flow in the window around, px."""
    side = 2 * RADIUS + 1
    window = np.ones((side, side), np.uint8)
    flow, alike = before[..., :2], (before[..., 2] < WANTING)[..., None]
    least = np.minimum(cv2.erode(np.where(alike, flow, BEYOND), window), flow)
    most = np.maximum(cv2.dilate(np.where(alike, flow, -BEYOND), window), flow)
    beyond = np.maximum(least - there[..., :2], there[..., :2] - most)
    return np.hypot(*cv2.split(np.maximum(beyond, 0)))


def _supported(new: np.ndarray, supported: np.ndarray) -> np.ndarray:
    """Return the connected areas of the new pixels that hold enough of those supported."""
    count, labels = cv2.connectedComponents(new.astype(np.uint8), connectivity=4)
    enough = np.bincount(labels[new & supported], minlength=count) >= SUPPORT
    enough[0] = False
    return enough[labels]


def _vouched(new: np.ndarray, there: np.ndarray, agreed: np.ndarray) -> np.ndarray:
    """Return those of the new pixels that move with as many of their area as are found both ways.

    Parameters
    ----------
    new : (h, w) bool
    there : (h, w, 4) float32
    agreed : (h, w) bool
        What is found both ways round.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(new.astype(np.uint8), connectivity=4)
    kept = np.zeros_like(new)
    for label in range(1, count):
        left, top, width, height, size = boxes[label]
        part = np.s_[top : top + height, left : left + width]
        area = labels[part] == label
        sure = area & agreed[part]
        if np.count_nonzero(sure) > VOUCHED * size:
            motion = there[part][..., :2]
            away = motion[area] - np.median(motion[sure], axis=0)
            kept[part][area] = np.hypot(*away.T) < 2 * AGREEMENT
    return kept


def _unmistakable(
    new: np.ndarray, there: np.ndarray, before: np.ndarray, windows: Windows
) -> np.ndarray:
    """Return the areas of new pixels whose motion is unlikely to be found by chance.

    An area has to vary along both directions: a stripe looks alike all along itself. It may not
    move too far: a large part of the image has places that look alike by chance.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(new.astype(np.uint8), connectivity=4)
    kept = np.zeros_like(new)
    if count == 1:
        return kept
    slope = np.array([[-0.5, 0, 0.5]], np.float32)
    across, down = (cv2.filter2D(windows.levels0, cv2.CV_32F, k) for k in (slope, slope.T))
    for label in range(1, count):
        left, top, width, height, size = boxes[label]
        part = np.s_[top : top + height, left : left + width]
        area = labels[part] == label
        slopes = np.stack([across[part][area], down[part][area]]).astype(np.float64)
        varies = np.linalg.eigvalsh(slopes @ slopes.T / size)[0]
        far, near = (np.median(state[part][area][:, :2], axis=0) for state in (there, before))
        way = np.hypot(*(far - near))
        if varies >= STRIPED * windows.noise**2 and way <= FARTHEST * max(windows.shape):
            kept[part] |= area
    return kept


def _turned(there: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return the way back, (h, w, 2), of the new pixels, in frame 1; elsewhere 0."""
    back = np.zeros_like(there[..., :2])
    row, column, _ = _target(there)
    back[row[new], column[new]] = -there[new][:, :2]
    return back


def _landing(there: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return where in frame 1 the new pixels go, and what is around, (h, w) bool."""
    mask = np.zeros(new.shape, bool)
    row, column, _ = _target(there)
    mask[row[new], column[new]] = True
    return _around(mask, AROUND)


def _around(mask: np.ndarray, side: int) -> np.ndarray:
    """Return a mask with the squares of a side, px, around its pixels."""
    wider = cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(wider) > 0


def _target(there: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest row and column that each pixel goes to, and whether there are such."""
    height, width = there.shape[:2]
    column = np.rint(there[..., 0] + np.arange(width, dtype=np.float32))
    row = np.rint(there[..., 1] + np.arange(height, dtype=np.float32)[:, None])
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = column.clip(0, width - 1), row.clip(0, height - 1)
    return row.astype(np.intp), column.astype(np.intp), inside


def _agreeing(there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return which displacements are found the other way round too."""
    row, column, inside = _target(there)
    back = here[row, column]
    apart = np.hypot(*cv2.split(there[..., :2] + back[..., :2]))
    cheap = (there[..., 2] < COST) & (back[..., 2] < UNSEEN) & (back[..., 3] > 0)
    return np.asarray(inside & cheap & (apart < AGREEMENT))


def _without_islands(there: np.ndarray, agreed: np.ndarray) -> np.ndarray:
    """Return those of some pixels that have many neighbours of nearly the same displacement."""
    for component in cv2.split(there[..., :2]):
        fixed = SIXTEENTHS * (component - component.min()) + 1
        fixed = np.where(agreed, fixed, 0).clip(0, np.iinfo(np.int16).max).astype(np.int16)
        cv2.filterSpeckles(fixed, 0, ISLAND, SIXTEENTHS)
        agreed = agreed & (fixed > 0)
    return agreed


def _carried(
    windows: Windows,
    evidence: ResidualComparison,
    found: np.ndarray,
    known: np.ndarray,
    before: np.ndarray,
) -> np.ndarray:
    """Return a flow with what is known carried to where the images bear it out.

    Of what leaves the image they say nothing: there it is enough that they contradict a flow that
    stays, or that the flow breaks off.
    """
    distance = np.where(known, 0, np.float32(found.size)).astype(np.float32)
    nearest = np.zeros((*windows.shape, 4), np.float32)
    nearest[..., :2], nearest[..., 3] = found, 1
    usual = mean_step(windows.levels0, windows.counted0)
    for _ in range(PASSES):
        carry(windows.levels0, distance, nearest, edge=EDGE * usual)
    windows.search.score(nearest, seen=SEEN)
    windows.ignore(nearest)
    cost = np.where(before[..., 2] < UNSEEN, before[..., 2], 0)
    lower = (nearest[..., 2] < cost - BETTER) & (cost > CARRIED_COST)
    lower &= evidence.better(nearest[..., :2], found, window=EVIDENCE, by=CARRIED)
    away = cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_L2, 3)
    breaks = np.hypot(*cv2.split(found - nearest[..., :2])) > STEEPEST * away
    leaves = (breaks | _target(before)[2]) & ~_target(nearest)[2] & (cost > WANTING)
    return np.where((~known & (lower | leaves))[..., None], nearest[..., :2], found)
