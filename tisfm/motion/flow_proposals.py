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
from tisfm.motion.matched_windows import (
    FEWEST,
    SEEN,
    ResidualComparison,
    Windows,
    WindowSearch,
    resize_flow,
    resize_mask,
)
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


def flow_proposals(
    pyramid: ImagePyramid,
    # Of free motion. Its first two unknowns are the flow, up to a factor of the whole image.
    problem: Problem,
) -> "FlowProposals | None":
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
    return FlowProposals(pyramid, problem, level)


class FlowProposals:
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
        levels = [k for k in self._search.levels if pyramid.frames0[k].size >= FEWEST_JUDGED]
        self._judged_level = levels[0] if levels else level
        self._scale = pyramid.scales[level]
        self._problem = problem
        self._objects: FastObjects | None = None

    def apply(self, unknowns: Unknowns) -> bool:
        """Correct ρ̂ on its level where the images show another motion; return whether they do."""
        flow = cv2.merge(list(unknowns.flow()))
        if not np.isfinite(flow).all():
            return False
        state, is_poor = self._evaluate(flow)
        corrected = flow
        if is_poor.mean() >= MANY_POOR:
            proposed = self._search_frame(flow)
            if proposed is None:
                return False
            if proposed is not flow:
                corrected = proposed
                state, is_poor = self._evaluate(corrected)
        corrected = self._add_fast_objects(corrected, state, is_poor)
        if corrected is flow:
            return False
        rho = unknowns.images()
        rho[:2] += cv2.split(corrected - flow)
        unknowns.set_images(rho)
        self.go_on(unknowns, self.level)
        return True

    def go_on(self, unknowns: Unknowns, level: int) -> None:
        """Separate fast objects from their surroundings on the next finer level."""
        if self._objects is not None:
            self._objects.cut_smoothness(self._search.windows(level), unknowns)

    def _evaluate(self, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state of a flow on the judged level, and where its matching cost is poor."""
        windows = self._search.windows(self._judged_level)
        coarse = resize_flow(flow, windows.shape, windows.scale / self._scale)
        state = windows.score_flow(coarse, min_variance=LEAST_VARIANCE)
        return state, (state[..., 2] > POOR_COST) & (state[..., 2] < UNSEEN)

    def _search_frame(self, flow: np.ndarray) -> np.ndarray | None:
        """Return a better flow of frames whose motion was missed in large parts.

        Returns None if the frames have too little in common.
        """
        search = self._search
        windows = search.windows(self.level)
        previous = windows.score_flow(flow)
        forward = search.match_forward(search.levels, initial_flows=[(flow, windows.scale)])
        is_consistent = _large_regions(
            forward, _is_consistent(forward, search.match_backward(search.levels))
        )
        if np.count_nonzero(is_consistent) < LEAST_ACCEPTED * np.count_nonzero(
            previous[..., 2] < UNSEEN
        ):
            return None
        comparison = ResidualComparison(windows, self._problem.constancy)
        is_new = is_consistent & _is_better(forward, previous)
        is_new &= comparison.is_better(forward[..., :2], flow, window=RESIDUAL_WINDOW)
        if not is_new.any():
            return flow
        proposed = np.where(is_new[..., None], forward[..., :2], flow)
        is_known = is_new | (is_consistent & ~_is_different(forward, flow))
        return _fill_flow(windows, comparison, proposed, is_known, previous)

    def _add_fast_objects(
        self, flow: np.ndarray, state: np.ndarray, is_poor: np.ndarray
    ) -> np.ndarray:
        """Return a flow with the motion of objects that move far for their size."""
        mask = _visible_poor_pixels(state, is_poor)
        if not mask.any():
            return flow
        search = self._search
        windows, coarse = search.windows(self._judged_level), state[..., :2]
        forward = search.match_forward(
            [self._judged_level], initial_flows=[(coarse, windows.scale)], mask=mask
        )
        is_new = _fast_areas(
            _is_better(forward, state), forward, state, min_speed=JUDGED_SPEED, min_area=JUDGED_AREA
        )
        if not is_new.any():
            return flow
        comparison = ResidualComparison(windows, self._problem.constancy)
        is_supported = comparison.is_better(
            forward[..., :2], coarse, window=RESIDUAL_WINDOW, min_gain=CLEAR_GAIN
        )
        is_new = _supported_areas(is_new, is_supported)
        if not is_new.any():
            return flow
        # Objects are suspected: they are searched again on the finer level, with more draws.
        suspected = forward[..., :2], windows.scale
        windows, level = search.windows(self.level), [self.level]
        mask = resize_mask(_dilate(is_new, 3), windows.shape)
        # Draws are made around known displacements. The suspected ones may be wrong, so the first
        # search leaves them out.
        forward = search.match_forward(
            level, initial_flows=[(flow, windows.scale)], mask=mask, wide_draws=RANDOM_DRAWS
        )
        initial_flows = [(forward[..., :2], windows.scale), suspected]
        forward = search.match_forward(level, initial_flows=initial_flows, mask=mask, wide_draws=0)
        comparison = ResidualComparison(windows, self._problem.constancy)
        previous = windows.score_flow(flow, mask=_dilate(mask, 2 * RADIUS + 1))
        is_new = mask & _is_better(forward, previous)
        is_new &= comparison.is_better(
            forward[..., :2], flow, window=RESIDUAL_WINDOW, min_gain=CLEAR_GAIN
        )
        is_new = _fast_areas(
            is_new, forward, previous, min_speed=CORRECTED_SPEED, min_area=CORRECTED_AREA
        )
        if not is_new.any():
            return flow
        backward = search.match_backward(
            [self.level],
            initial_flows=[(-flow, windows.scale), (_reverse_flow(forward, is_new), windows.scale)],
            mask=_target_mask(forward, is_new),
            wide_draws=RANDOM_DRAWS,
        )
        is_new = _consistent_pixels(is_new, forward, _is_consistent(forward, backward))
        is_new = _fast_areas(
            is_new, forward, previous, min_speed=CORRECTED_SPEED, min_area=CORRECTED_AREA
        )
        is_new = _distinctive_areas(is_new, forward, previous, windows)
        if not is_new.any():
            return flow
        self._objects = FastObjects(is_new, self._problem)
        return np.where(is_new[..., None], forward[..., :2], flow)


def _visible_poor_pixels(state: np.ndarray, is_poor: np.ndarray) -> np.ndarray:
    """Return the poor pixels that do not seem occluded, (h, w) bool.

    They stay in the image, no well-matched pixel goes to the same target, and they are not
    isolated.
    """
    row, column, inside = _target_pixels(state)
    is_good = inside & (state[..., 2] < GOOD_COST)
    is_target = np.zeros(is_poor.shape, np.uint8)
    is_target[row[is_good], column[is_good]] = 1
    square = np.ones((3, 3), np.uint8)
    is_free = cv2.dilate(is_target, square)[row, column] == 0
    candidates = (is_poor & inside & is_free).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(candidates, cv2.MORPH_OPEN, square)) > 0


def _is_different(state: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return where the displacement of a state differs from a flow."""
    return np.hypot(*cv2.split(state[..., :2] - flow)) > NEW_DISTANCE


def _is_better(forward: np.ndarray, previous: np.ndarray) -> np.ndarray:
    """Return where a displacement differs from the previous one and matches better."""
    is_cheaper = forward[..., 2] < np.minimum(previous[..., 2] - NEW_GAIN, LARGEST_COST)
    return is_cheaper & (previous[..., 2] < UNSEEN) & _is_different(forward, previous[..., :2])


def _fast_areas(
    is_new: np.ndarray,
    forward: np.ndarray,
    previous: np.ndarray,
    *,
    min_speed: float,
    min_area: int,
) -> np.ndarray:
    """Return the new pixels of connected areas that move far for their size.

    An area has at least `min_area` px. It moves by more than `min_speed` times the square root of
    its size, relative to its own previous flow and to the flow of the well-matched pixels around
    it. The flow of surfaces without texture does not count.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        is_new.astype(np.uint8), connectivity=4
    )
    size = boxes[:, cv2.CC_STAT_AREA]
    is_fast = size >= min_area
    is_fast[0] = False
    if not is_fast.any():
        return np.zeros_like(is_new)
    first, extent = boxes[is_fast, :2], boxes[is_fast, 2:4]
    left, top = np.maximum(first.min(axis=0) - RADIUS, 0)
    end, bottom = (first + extent).max(axis=0) + RADIUS
    part = np.s_[top:bottom, left:end]
    relative_motion = _relative_motion(forward[part], previous[part])
    mean = np.bincount(labels[part].ravel(), relative_motion.ravel(), minlength=count) / np.maximum(
        size, 1
    )
    return (is_fast & (mean > min_speed * np.sqrt(size)))[labels]


def _relative_motion(forward: np.ndarray, previous: np.ndarray) -> np.ndarray:
    """Return the distance of displacements from the range of the flow in their window, px."""
    side = 2 * RADIUS + 1
    window = np.ones((side, side), np.uint8)
    flow, is_matched = previous[..., :2], (previous[..., 2] < POOR_COST)[..., None]
    lowest = np.minimum(cv2.erode(np.where(is_matched, flow, BEYOND), window), flow)
    highest = np.maximum(cv2.dilate(np.where(is_matched, flow, -BEYOND), window), flow)
    excess = np.maximum(lowest - forward[..., :2], forward[..., :2] - highest)
    return np.hypot(*cv2.split(np.maximum(excess, 0)))


def _supported_areas(is_new: np.ndarray, is_supported: np.ndarray) -> np.ndarray:
    """Return the connected areas of new pixels that have enough supported pixels."""
    count, labels = cv2.connectedComponents(is_new.astype(np.uint8), connectivity=4)
    has_support = np.bincount(labels[is_new & is_supported], minlength=count) >= LEAST_SUPPORT
    has_support[0] = False
    return has_support[labels]


def _consistent_pixels(
    is_new: np.ndarray,  # (h, w) bool
    forward: np.ndarray,  # (h, w, 4) float32
    is_consistent: np.ndarray,  # (h, w) bool: pixels whose displacement is found in both directions
) -> np.ndarray:
    """Return new pixels that move like the pixels of their area found in both directions.

    Areas without enough such pixels are dropped.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        is_new.astype(np.uint8), connectivity=4
    )
    result = np.zeros_like(is_new)
    for label in range(1, count):
        left, top, width, height, size = boxes[label]
        part = np.s_[top : top + height, left : left + width]
        area = labels[part] == label
        is_confirmed = area & is_consistent[part]
        if np.count_nonzero(is_confirmed) > LEAST_CONSISTENT * size:
            motion = forward[part][..., :2]
            difference = motion[area] - np.median(motion[is_confirmed], axis=0)
            result[part][area] = np.hypot(*difference.T) < 2 * LARGEST_DISAGREEMENT
    return result


def _distinctive_areas(
    is_new: np.ndarray, forward: np.ndarray, previous: np.ndarray, windows: Windows
) -> np.ndarray:
    """Return the areas of new pixels whose motion is unlikely to be a chance match.

    An area has to vary along both directions, since a stripe matches anywhere along itself. It may
    not move too far, since a large search area contains chance matches.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        is_new.astype(np.uint8), connectivity=4
    )
    result = np.zeros_like(is_new)
    if count == 1:
        return result
    slope = np.array([[-0.5, 0, 0.5]], np.float32)
    across, down = (cv2.filter2D(windows.grey0, cv2.CV_32F, k) for k in (slope, slope.T))
    for label in range(1, count):
        left, top, width, height, size = boxes[label]
        part = np.s_[top : top + height, left : left + width]
        area = labels[part] == label
        slopes = np.stack([across[part][area], down[part][area]]).astype(np.float64)
        weakest_slope = np.linalg.eigvalsh(slopes @ slopes.T / size)[0]
        motion, previous_motion = (
            np.median(state[part][area][:, :2], axis=0) for state in (forward, previous)
        )
        distance = np.hypot(*(motion - previous_motion))
        if weakest_slope >= LEAST_SLOPE * windows.noise**2 and distance <= LARGEST_MOTION * max(
            windows.shape
        ):
            result[part] |= area
    return result


def _reverse_flow(forward: np.ndarray, is_new: np.ndarray) -> np.ndarray:
    """Return the reverse displacements of new pixels at their targets, (h, w, 2); elsewhere 0."""
    reverse = np.zeros_like(forward[..., :2])
    row, column, _ = _target_pixels(forward)
    reverse[row[is_new], column[is_new]] = -forward[is_new][:, :2]
    return reverse


def _target_mask(forward: np.ndarray, is_new: np.ndarray) -> np.ndarray:
    """Return the targets of new pixels in frame 1, with a window around each, (h, w) bool."""
    mask = np.zeros(is_new.shape, bool)
    row, column, _ = _target_pixels(forward)
    mask[row[is_new], column[is_new]] = True
    return _dilate(mask, LANDING_WINDOW)


def _dilate(mask: np.ndarray, side: int) -> np.ndarray:
    """Return a mask that is dilated by a square of a side, px."""
    dilated = cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(dilated) > 0


def _target_pixels(state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the row and column nearest to each target, and whether the target is in the image."""
    height, width = state.shape[:2]
    column = np.rint(state[..., 0] + np.arange(width, dtype=np.float32))
    row = np.rint(state[..., 1] + np.arange(height, dtype=np.float32)[:, None])
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = column.clip(0, width - 1), row.clip(0, height - 1)
    return row.astype(np.intp), column.astype(np.intp), inside


def _is_consistent(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """Return which displacements are also found from frame 1 to frame 0."""
    row, column, inside = _target_pixels(forward)
    reverse = backward[row, column]
    disagreement = np.hypot(*cv2.split(forward[..., :2] + reverse[..., :2]))
    is_match = (forward[..., 2] < LARGEST_COST) & (reverse[..., 2] < UNSEEN) & (reverse[..., 3] > 0)
    return np.asarray(inside & is_match & (disagreement < LARGEST_DISAGREEMENT))


def _large_regions(forward: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the agreed pixels without small islands of their own displacement."""
    for component in cv2.split(forward[..., :2]):
        sixteenths = SIXTEENTHS * (component - component.min()) + 1
        sixteenths = np.where(mask, sixteenths, 0).clip(0, np.iinfo(np.int16).max).astype(np.int16)
        cv2.filterSpeckles(sixteenths, 0, SMALLEST_ISLAND, SIXTEENTHS)
        mask = mask & (sixteenths > 0)
    return mask


def _fill_flow(
    windows: Windows,
    comparison: ResidualComparison,
    flow: np.ndarray,
    is_known: np.ndarray,
    previous: np.ndarray,
) -> np.ndarray:
    """Return a flow whose unknown pixels take the nearest known flow, if the images confirm it.

    The images cannot confirm a flow that leaves the image. Such a flow is taken where the present
    flow stays inside and does not match, or where the present flow breaks off.
    """
    distance = np.where(is_known, 0, np.float32(flow.size)).astype(np.float32)
    nearest = np.zeros((*windows.shape, 4), np.float32)
    nearest[..., :2], nearest[..., 3] = flow, 1
    mean_grey_step = mean_step(windows.grey0, windows.counted0)
    for _ in range(FILL_PASSES):
        carry(windows.grey0, distance, nearest, edge=EDGE_DISTANCE * mean_grey_step)
    windows.search.score(nearest, seen=SEEN)
    windows.mark_invalid(nearest)
    cost = np.where(previous[..., 2] < UNSEEN, previous[..., 2], 0)
    is_cheaper = (nearest[..., 2] < cost - NEW_GAIN) & (cost > LEAST_FILLED_COST)
    is_cheaper &= comparison.is_better(
        nearest[..., :2], flow, window=RESIDUAL_WINDOW, min_gain=FILL_GAIN
    )
    distance_px = cv2.distanceTransform((~is_known).astype(np.uint8), cv2.DIST_L2, 3)
    is_broken = np.hypot(*cv2.split(flow - nearest[..., :2])) > STEEPEST * distance_px
    leaves_image = (
        (is_broken | _target_pixels(previous)[2]) & ~_target_pixels(nearest)[2] & (cost > POOR_COST)
    )
    return np.where((~is_known & (is_cheaper | leaves_image))[..., None], nearest[..., :2], flow)
