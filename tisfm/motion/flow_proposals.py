"""Motions that coarse-to-fine estimation missed, searched where the flow does not fit the images.

On a coarse level, an object that moves far for its size is too small to be seen apart from its
surroundings, and finer levels only improve the flow that they start from. Therefore, once, on a
level that shows most objects, windows of both frames are compared along the flow. Where they
differ, displacements of the neighbourhood are tried in both directions, from frame 0 to frame 1
and back, and the images decide pixel by pixel. The minimisation continues from the result.
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

LARGEST_LEVEL = 2**18  # pixels of the level whose flow is corrected; set by hand
LONGEST_SIDE = 2**15 - 2  # px: cv2.remap takes no longer frames
FEWEST_JUDGED = 2**14  # pixels, at least, of the level on which the flow is judged; set by hand
POOR_COST = 0.5  # matching cost above which a flow is wrong, unless the pixel is occluded
GOOD_COST = 0.3  # matching cost above that of most correct flows
LEAST_VARIANCE = 6.0  # variance of a window that is judged, over the variance of the noise
# Share of poor pixels from which the whole frame is searched: at most 0.06 where motion is right,
# 0.11 and more where much of it is missed. Below it, only fast objects are searched.
MANY_POOR = 0.08
LANDING_WINDOW = 7  # px of the judged level: side of the window searched around a target pixel
LARGEST_COST = 0.5  # of a displacement that is accepted
LARGEST_DISAGREEMENT = 2.0  # px between a displacement and the one of the other direction
SMALLEST_ISLAND = 100  # pixels with displacements within 1 px of each other; smaller ones go
SIXTEENTHS = 16  # units of a pixel, in which displacements are given to cv2.filterSpeckles
# Accepted pixels over textured pixels: 0.6 and more in frames of one scene, below 0.05 in others.
LEAST_ACCEPTED = 0.2
# Fast objects: least area, and least motion over the square root of the area. On the judged level,
# areas are larger by the size of the windows.
JUDGED_AREA = 24  # px of the judged level
CORRECTED_AREA = 50  # px of the corrected level
JUDGED_SPEED = 0.25
CORRECTED_SPEED = 0.5
LEAST_SUPPORT = 10  # pixels of an area, on the judged level, whose residual falls clearly
NEW_DISTANCE = 1.0  # px by which a new displacement differs
NEW_GAIN = 0.05  # by which the matching cost of a new displacement is lower
BEYOND = np.float32(LONGEST_SIDE)  # px: longer than any flow
RESIDUAL_WINDOW = 5  # px: side of the square whose residuals are compared
LEAST_CONSISTENT = 0.25  # share of an area that is found in both directions
# Least mean square of the slope along any direction, over the variance of the noise, of a fast
# object. Noise alone has ½; correct areas had 0.97 and more.
LEAST_SLOPE = 0.8
# Largest motion of a fast object, over the longer side. Correct areas moved by at most 0.35, the
# limit of the search (`tisfm.motion.matched_windows.LARGEST`), and wrong ones by 0.5.
LARGEST_MOTION = 0.4
RANDOM_DRAWS = 2**15  # random displacements in each round, where an object is suspected
CLEAR_GAIN = 0.6  # deviations of the noise by which residuals fall for a fast object
FILL_GAIN = 0.3  # deviations of the noise by which residuals fall for a neighbour's displacement
LEAST_FILLED_COST = 0.3  # of a displacement that a neighbour's may replace
STEEPEST = 0.5  # px/frame per px: a flow that changes faster, beyond turns and zooms, is broken
FILL_PASSES = 6  # of filling from known pixels, along rows and columns
# Mean steps of grey level that count as one pixel of distance while a flow is filled.
EDGE_DISTANCE = 0.33


def proposals(
    pyramid: ImagePyramid,
    # Of free motion. Its first two unknowns are the flow, up to a factor of the whole image.
    problem: Problem,
) -> "Proposals | None":
    """Return the correction of a flow between coarse and fine levels; None if it does not pay."""
    if pyramid.levels == 1 or pyramid.frames0[-1].size > LARGEST_LEVEL:
        # The settings ask for few scales
        return None
    levels = range(pyramid.last, pyramid.levels)
    level = next(k for k in levels if pyramid.frames0[k].size <= LARGEST_LEVEL)
    height, width = pyramid.frames0[level].shape
    if (
        height * width < FEWEST
        or min(height, width) <= 2 * RADIUS
        or max(pyramid.shape) > LONGEST_SIDE
    ):
        return None
    return Proposals(pyramid, problem, level)


class Proposals:
    """An `Amendment`: motions that the images of a level confirm where they contradict the flow.

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
        large = [k for k in self._search.levels if pyramid.frames0[k].size >= FEWEST_JUDGED]
        self._judged = large[0] if large else level
        self._scale = pyramid.scales[level]
        self._problem = problem
        self._objects: FastObjects | None = None

    def apply(self, unknowns: Unknowns) -> bool:
        """Correct ρ̂ on its level where the images show another motion; return whether they do."""
        flow = cv2.merge(list(unknowns.flow()))
        if not np.isfinite(flow).all():
            return False
        judged, poor = self._judge(flow)
        better = flow
        if poor.mean() >= MANY_POOR:
            found = self._search_frame(flow)
            if found is None:
                return False
            if found is not flow:
                better = found
                judged, poor = self._judge(better)
        better = self._with_objects(better, judged, poor)
        if better is flow:
            return False
        rho = unknowns.images()
        rho[:2] += cv2.split(better - flow)
        unknowns.set_images(rho)
        self.go_on(unknowns, self.level)
        return True

    def go_on(self, unknowns: Unknowns, level: int) -> None:
        """Separate fast objects from their surroundings on the next finer level."""
        if self._objects is not None:
            self._objects.set_apart(self._search.windows(level), unknowns)

    def _judge(self, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state of a flow on the judged level, and where its matching cost is poor."""
        windows = self._search.windows(self._judged)
        coarse = resized(flow, windows.shape, windows.scale / self._scale)
        judged = windows.scored(coarse, seen=LEAST_VARIANCE)
        return judged, (judged[..., 2] > POOR_COST) & (judged[..., 2] < UNSEEN)

    def _search_frame(self, flow: np.ndarray) -> np.ndarray | None:
        """Return a better flow of frames whose motion was missed in large parts.

        Returns None if the frames have too little in common.
        """
        search = self._search
        windows = search.windows(self.level)
        known = [(flow, windows.scale)]
        before, there = windows.scored(flow), search.forward(search.levels, known=known)
        agreed = _without_islands(there, _agreeing(there, search.backward(search.levels)))
        if np.count_nonzero(agreed) < LEAST_ACCEPTED * np.count_nonzero(before[..., 2] < UNSEEN):
            return None
        comparison = ResidualComparison(windows, self._problem.constancy)
        new = agreed & _new(there, before)
        new &= comparison.better(there[..., :2], flow, window=RESIDUAL_WINDOW)
        if not new.any():
            return flow
        found = np.where(new[..., None], there[..., :2], flow)
        known = new | (agreed & ~_differs(there, flow))
        return _fill_flow(windows, comparison, found, known, before)

    def _with_objects(self, flow: np.ndarray, judged: np.ndarray, poor: np.ndarray) -> np.ndarray:
        """Return a flow with the motion of objects that move far for their size."""
        sought = _visible_poor(judged, poor)
        if not sought.any():
            return flow
        search = self._search
        windows, coarse = search.windows(self._judged), judged[..., :2]
        there = search.forward([self._judged], known=[(coarse, windows.scale)], sought=sought)
        new = _fast(_new(there, judged), there, judged, speed=JUDGED_SPEED, least=JUDGED_AREA)
        if not new.any():
            return flow
        comparison = ResidualComparison(windows, self._problem.constancy)
        supported = comparison.better(there[..., :2], coarse, window=RESIDUAL_WINDOW, by=CLEAR_GAIN)
        new = _supported(new, supported)
        if not new.any():
            return flow
        # Objects are suspected: they are searched again on the finer level, with more draws.
        found = there[..., :2], windows.scale
        windows, level = search.windows(self.level), [self.level]
        sought = masked(_around(new, 3), windows.shape)
        # Draws are made around known displacements. The suspected ones may be wrong, so the first
        # search leaves them out.
        there = search.forward(
            level, known=[(flow, windows.scale)], sought=sought, tried=RANDOM_DRAWS
        )
        known = [(there[..., :2], windows.scale), found]
        there = search.forward(level, known=known, sought=sought, tried=0)
        comparison = ResidualComparison(windows, self._problem.constancy)
        before = windows.scored(flow, sought=_around(sought, 2 * RADIUS + 1))
        new = sought & _new(there, before)
        new &= comparison.better(there[..., :2], flow, window=RESIDUAL_WINDOW, by=CLEAR_GAIN)
        new = _fast(new, there, before, speed=CORRECTED_SPEED, least=CORRECTED_AREA)
        if not new.any():
            return flow
        here = search.backward(
            [self.level],
            known=[(-flow, windows.scale), (_reverse(there, new), windows.scale)],
            sought=_targets(there, new),
            tried=RANDOM_DRAWS,
        )
        new = _consistent(new, there, _agreeing(there, here))
        new = _fast(new, there, before, speed=CORRECTED_SPEED, least=CORRECTED_AREA)
        new = _distinctive(new, there, before, windows)
        if not new.any():
            return flow
        self._objects = FastObjects(new, self._problem)
        return np.where(new[..., None], there[..., :2], flow)


def _visible_poor(judged: np.ndarray, poor: np.ndarray) -> np.ndarray:
    """Return the poor pixels that do not seem occluded, (h, w) bool.

    They stay in the image, no well-matched pixel goes to the same target, and they are not
    isolated.
    """
    row, column, inside = _target(judged)
    good = inside & (judged[..., 2] < GOOD_COST)
    taken = np.zeros(poor.shape, np.uint8)
    taken[row[good], column[good]] = 1
    square = np.ones((3, 3), np.uint8)
    free = cv2.dilate(taken, square)[row, column] == 0
    left = (poor & inside & free).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(left, cv2.MORPH_OPEN, square)) > 0


def _differs(state: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return where the displacement of a state differs from a flow."""
    return np.hypot(*cv2.split(state[..., :2] - flow)) > NEW_DISTANCE


def _new(there: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return where a displacement differs from the previous one and matches better."""
    better = there[..., 2] < np.minimum(before[..., 2] - NEW_GAIN, LARGEST_COST)
    return better & (before[..., 2] < UNSEEN) & _differs(there, before[..., :2])


def _fast(
    new: np.ndarray, there: np.ndarray, before: np.ndarray, *, speed: float, least: int
) -> np.ndarray:
    """Return the new pixels of connected areas that move far for their size.

    An area has at least `least` px. It moves by more than `speed` times the square root of its
    size, relative to its own previous flow and to the flow of the well-matched pixels around it.
    The flow of surfaces without texture does not count.
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
    away = _relative_motion(there[part], before[part])
    mean = np.bincount(labels[part].ravel(), away.ravel(), minlength=count) / np.maximum(size, 1)
    return (large & (mean > speed * np.sqrt(size)))[labels]


def _relative_motion(there: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the distance of displacements from the range of the flow in their window, px."""
    side = 2 * RADIUS + 1
    window = np.ones((side, side), np.uint8)
    flow, matched = before[..., :2], (before[..., 2] < POOR_COST)[..., None]
    least = np.minimum(cv2.erode(np.where(matched, flow, BEYOND), window), flow)
    most = np.maximum(cv2.dilate(np.where(matched, flow, -BEYOND), window), flow)
    beyond = np.maximum(least - there[..., :2], there[..., :2] - most)
    return np.hypot(*cv2.split(np.maximum(beyond, 0)))


def _supported(new: np.ndarray, supported: np.ndarray) -> np.ndarray:
    """Return the connected areas of new pixels that have enough supported pixels."""
    count, labels = cv2.connectedComponents(new.astype(np.uint8), connectivity=4)
    enough = np.bincount(labels[new & supported], minlength=count) >= LEAST_SUPPORT
    enough[0] = False
    return enough[labels]


def _consistent(
    new: np.ndarray,  # (h, w) bool
    there: np.ndarray,  # (h, w, 4) float32
    agreed: np.ndarray,  # (h, w) bool: pixels whose displacement is found in both directions
) -> np.ndarray:
    """Return new pixels that move like the pixels of their area found in both directions.

    Areas without enough such pixels are dropped.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(new.astype(np.uint8), connectivity=4)
    kept = np.zeros_like(new)
    for label in range(1, count):
        left, top, width, height, size = boxes[label]
        part = np.s_[top : top + height, left : left + width]
        area = labels[part] == label
        found_twice = area & agreed[part]
        if np.count_nonzero(found_twice) > LEAST_CONSISTENT * size:
            motion = there[part][..., :2]
            away = motion[area] - np.median(motion[found_twice], axis=0)
            kept[part][area] = np.hypot(*away.T) < 2 * LARGEST_DISAGREEMENT
    return kept


def _distinctive(
    new: np.ndarray, there: np.ndarray, before: np.ndarray, windows: Windows
) -> np.ndarray:
    """Return the areas of new pixels whose motion is unlikely to be a chance match.

    An area has to vary along both directions, since a stripe matches anywhere along itself. It may
    not move too far, since a large search area contains chance matches.
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
        distance = np.hypot(*(far - near))
        if varies >= LEAST_SLOPE * windows.noise**2 and distance <= LARGEST_MOTION * max(
            windows.shape
        ):
            kept[part] |= area
    return kept


def _reverse(there: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return the reverse displacements of new pixels at their targets, (h, w, 2); elsewhere 0."""
    back = np.zeros_like(there[..., :2])
    row, column, _ = _target(there)
    back[row[new], column[new]] = -there[new][:, :2]
    return back


def _targets(there: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return the targets of new pixels in frame 1, with a window around each, (h, w) bool."""
    mask = np.zeros(new.shape, bool)
    row, column, _ = _target(there)
    mask[row[new], column[new]] = True
    return _around(mask, LANDING_WINDOW)


def _around(mask: np.ndarray, side: int) -> np.ndarray:
    """Return a mask that is dilated by a square of a side, px."""
    wider = cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(wider) > 0


def _target(there: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the row and column nearest to each target, and whether the target is in the image."""
    height, width = there.shape[:2]
    column = np.rint(there[..., 0] + np.arange(width, dtype=np.float32))
    row = np.rint(there[..., 1] + np.arange(height, dtype=np.float32)[:, None])
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = column.clip(0, width - 1), row.clip(0, height - 1)
    return row.astype(np.intp), column.astype(np.intp), inside


def _agreeing(there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return which displacements are also found from frame 1 to frame 0."""
    row, column, inside = _target(there)
    back = here[row, column]
    apart = np.hypot(*cv2.split(there[..., :2] + back[..., :2]))
    cheap = (there[..., 2] < LARGEST_COST) & (back[..., 2] < UNSEEN) & (back[..., 3] > 0)
    return np.asarray(inside & cheap & (apart < LARGEST_DISAGREEMENT))


def _without_islands(there: np.ndarray, agreed: np.ndarray) -> np.ndarray:
    """Return the agreed pixels without small islands of their own displacement."""
    for component in cv2.split(there[..., :2]):
        fixed = SIXTEENTHS * (component - component.min()) + 1
        fixed = np.where(agreed, fixed, 0).clip(0, np.iinfo(np.int16).max).astype(np.int16)
        cv2.filterSpeckles(fixed, 0, SMALLEST_ISLAND, SIXTEENTHS)
        agreed = agreed & (fixed > 0)
    return agreed


def _fill_flow(
    windows: Windows,
    comparison: ResidualComparison,
    found: np.ndarray,
    known: np.ndarray,
    before: np.ndarray,
) -> np.ndarray:
    """Return a flow whose unknown pixels take the nearest known flow, if the images confirm it.

    The images cannot confirm a flow that leaves the image. Such a flow is taken where the present
    flow stays inside and does not match, or where the present flow breaks off.
    """
    distance = np.where(known, 0, np.float32(found.size)).astype(np.float32)
    nearest = np.zeros((*windows.shape, 4), np.float32)
    nearest[..., :2], nearest[..., 3] = found, 1
    usual = mean_step(windows.levels0, windows.counted0)
    for _ in range(FILL_PASSES):
        carry(windows.levels0, distance, nearest, edge=EDGE_DISTANCE * usual)
    windows.search.score(nearest, seen=SEEN)
    windows.ignore(nearest)
    cost = np.where(before[..., 2] < UNSEEN, before[..., 2], 0)
    lower = (nearest[..., 2] < cost - NEW_GAIN) & (cost > LEAST_FILLED_COST)
    lower &= comparison.better(nearest[..., :2], found, window=RESIDUAL_WINDOW, by=FILL_GAIN)
    away = cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_L2, 3)
    breaks = np.hypot(*cv2.split(found - nearest[..., :2])) > STEEPEST * away
    leaves = (breaks | _target(before)[2]) & ~_target(nearest)[2] & (cost > POOR_COST)
    return np.where((~known & (lower | leaves))[..., None], nearest[..., :2], found)
