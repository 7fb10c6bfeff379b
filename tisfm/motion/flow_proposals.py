"""Motions that coarse-to-fine estimation missed, searched where the flow does not fit the images.

On a coarse level, an object that moves far for its size is too small to be seen apart from its
surroundings, and finer levels only improve the flow that they start from. Therefore, on one level
that shows most objects, windows of both frames are compared along the flow. Where the windows
differ, displacements of the neighbourhood are tried in both directions, from frame 0 to frame 1
and back, and the images decide pixel by pixel. The minimisation continues from the result.
"""

import cv2
import numpy as np

from tisfm.kernels.rigid.flow_search import propagate_flow
from tisfm.kernels.rigid.windows import RADIUS, UNTEXTURED
from tisfm.motion.fast_objects import (
    MAX_SIDE,
    FastObjects,
    consistent_pixels,
    distinctive_areas,
    fast_areas,
    supported_areas,
)
from tisfm.motion.matched_planes import REGION_UNITS
from tisfm.motion.matched_windows import (
    ResidualComparison,
    Windows,
    WindowSearch,
    resize_flow,
    resize_mask,
)
from tisfm.motion.settings import PROPOSALS
from tisfm.solver.coarse_to_fine import Problem
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.smoothness import mean_step
from tisfm.solver.unknowns import Unknowns


def flow_proposals(
    pyramid: ImagePyramid,
    # problem of free motion; its first two unknowns are the flow, up to a factor of all pixels
    problem: Problem,
) -> "FlowProposals | None":
    """Return the correction of a flow between coarse and fine levels; None if no level suits."""
    if pyramid.levels == 1 or pyramid.frames0[-1].size > PROPOSALS.max_pixels:
        # The settings exclude a level that is coarse enough.
        return None
    levels = range(pyramid.last, pyramid.levels)
    level = next(k for k in levels if pyramid.frames0[k].size <= PROPOSALS.max_pixels)
    height, width = pyramid.frames0[level].shape
    if (
        height * width < PROPOSALS.min_search_pixels
        or min(height, width) <= 2 * RADIUS
        or max(pyramid.shape) > MAX_SIDE
    ):
        return None
    return FlowProposals(pyramid, problem, level)


class FlowProposals:
    """A `LevelChange`: motions that the images of a level confirm where they contradict the flow.

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
        levels = [
            k for k in self._search.levels if pyramid.frames0[k].size >= PROPOSALS.min_judged_pixels
        ]
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
        corrected_flow = flow
        if is_poor.mean() >= PROPOSALS.min_poor_share:
            new_flow = self._search_frame(flow)
            if new_flow is None:
                return False
            if new_flow is not flow:
                corrected_flow = new_flow
                state, is_poor = self._evaluate(corrected_flow)
        corrected_flow = self._add_fast_objects(corrected_flow, state, is_poor)
        if corrected_flow is flow:
            return False
        rho = unknowns.images()
        rho[:2] += cv2.split(corrected_flow - flow)
        unknowns.set_images(rho)
        self.change_finer_level(unknowns, self.level)
        return True

    def change_finer_level(self, unknowns: Unknowns, level: int) -> None:
        """Separate fast objects from their surroundings on the next finer level."""
        if self._objects is not None:
            self._objects.cut_smoothness(self._search.windows(level), unknowns)

    def _evaluate(self, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state of a flow on the judged level, and where its matching cost is poor."""
        windows = self._search.windows(self._judged_level)
        coarse_flow = resize_flow(flow, windows.shape, windows.scale / self._scale)
        state = windows.score_flow(coarse_flow, min_variance=PROPOSALS.min_judged_variance)
        return state, (state[..., 2] > PROPOSALS.min_poor_cost) & (state[..., 2] < UNTEXTURED)

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
        if np.count_nonzero(is_consistent) < PROPOSALS.min_accepted_share * np.count_nonzero(
            previous[..., 2] < UNTEXTURED
        ):
            return None
        comparison = ResidualComparison(windows, self._problem.constancy)
        is_new = is_consistent & _is_better(forward, previous)
        is_new &= comparison.is_better(forward[..., :2], flow, window=PROPOSALS.residual_window)
        if not is_new.any():
            return flow
        new_flow = np.where(is_new[..., None], forward[..., :2], flow)
        is_known = is_new | (is_consistent & ~_is_different(forward, flow))
        return _fill_flow(windows, comparison, new_flow, is_known, previous)

    def _add_fast_objects(
        self, flow: np.ndarray, state: np.ndarray, is_poor: np.ndarray
    ) -> np.ndarray:
        """Return a flow with the motion of objects that move far for their size."""
        mask = _visible_poor_pixels(state, is_poor)
        if not mask.any():
            return flow
        search = self._search
        windows, coarse_flow = search.windows(self._judged_level), state[..., :2]
        forward = search.match_forward(
            [self._judged_level], initial_flows=[(coarse_flow, windows.scale)], mask=mask
        )
        is_new = fast_areas(
            _is_better(forward, state),
            forward,
            state,
            min_speed=PROPOSALS.min_judged_speed,
            min_area=PROPOSALS.min_judged_area,
        )
        if not is_new.any():
            return flow
        comparison = ResidualComparison(windows, self._problem.constancy)
        is_supported = comparison.is_better(
            forward[..., :2],
            coarse_flow,
            window=PROPOSALS.residual_window,
            min_gain=PROPOSALS.object_gain,
        )
        is_new = supported_areas(is_new, is_supported)
        if not is_new.any():
            return flow
        # Suspected objects are searched again on the finer level, with more draws.
        suspected_flow = forward[..., :2], windows.scale
        windows, level = search.windows(self.level), [self.level]
        mask = resize_mask(_dilate(is_new, 3), windows.shape)
        # Draws are made around initial displacements. The suspected displacements may be wrong, so
        # the first search leaves them out.
        forward = search.match_forward(
            level,
            initial_flows=[(flow, windows.scale)],
            mask=mask,
            wide_draws=PROPOSALS.object_draws,
        )
        initial_flows = [(forward[..., :2], windows.scale), suspected_flow]
        forward = search.match_forward(level, initial_flows=initial_flows, mask=mask, wide_draws=0)
        comparison = ResidualComparison(windows, self._problem.constancy)
        previous = windows.score_flow(flow, mask=_dilate(mask, 2 * RADIUS + 1))
        is_new = mask & _is_better(forward, previous)
        is_new &= comparison.is_better(
            forward[..., :2], flow, window=PROPOSALS.residual_window, min_gain=PROPOSALS.object_gain
        )
        is_new = fast_areas(
            is_new,
            forward,
            previous,
            min_speed=PROPOSALS.min_corrected_speed,
            min_area=PROPOSALS.min_corrected_area,
        )
        if not is_new.any():
            return flow
        backward = search.match_backward(
            [self.level],
            initial_flows=[(-flow, windows.scale), (_reverse_flow(forward, is_new), windows.scale)],
            mask=_target_mask(forward, is_new),
            wide_draws=PROPOSALS.object_draws,
        )
        is_new = consistent_pixels(is_new, forward, _is_consistent(forward, backward))
        is_new = fast_areas(
            is_new,
            forward,
            previous,
            min_speed=PROPOSALS.min_corrected_speed,
            min_area=PROPOSALS.min_corrected_area,
        )
        is_new = distinctive_areas(is_new, forward, previous, windows)
        if not is_new.any():
            return flow
        self._objects = FastObjects(is_new, self._problem)
        return np.where(is_new[..., None], forward[..., :2], flow)


def _visible_poor_pixels(state: np.ndarray, is_poor: np.ndarray) -> np.ndarray:
    """Return the poor pixels that do not seem occluded, (h, w) bool.

    Their target is in the image, no well-matched pixel has this target, and they are not isolated.
    """
    row, column, is_inside = _target_pixels(state)
    is_good = is_inside & (state[..., 2] < PROPOSALS.max_good_cost)
    is_target = np.zeros(is_poor.shape, np.uint8)
    is_target[row[is_good], column[is_good]] = 1
    square = np.ones((3, 3), np.uint8)
    is_untargeted = cv2.dilate(is_target, square)[row, column] == 0
    candidates = (is_poor & is_inside & is_untargeted).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(candidates, cv2.MORPH_OPEN, square)) > 0


def _is_different(state: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return where the displacement of a state differs from a flow."""
    return np.hypot(*cv2.split(state[..., :2] - flow)) > PROPOSALS.min_change


def _is_better(forward: np.ndarray, previous: np.ndarray) -> np.ndarray:
    """Return where a displacement differs from the previous one and matches better."""
    is_cheaper = forward[..., 2] < np.minimum(
        previous[..., 2] - PROPOSALS.min_cost_gain, PROPOSALS.max_cost
    )
    return is_cheaper & (previous[..., 2] < UNTEXTURED) & _is_different(forward, previous[..., :2])


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
    return _dilate(mask, PROPOSALS.target_window)


def _dilate(mask: np.ndarray, side: int) -> np.ndarray:
    """Return a mask that is dilated by a square of a side, px."""
    dilation = cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(dilation) > 0


def _target_pixels(state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the row and column nearest to each target, and whether the target is in the image."""
    height, width = state.shape[:2]
    column = np.rint(state[..., 0] + np.arange(width, dtype=np.float32))
    row = np.rint(state[..., 1] + np.arange(height, dtype=np.float32)[:, None])
    is_inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = column.clip(0, width - 1), row.clip(0, height - 1)
    return row.astype(np.intp), column.astype(np.intp), is_inside


def _is_consistent(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """Return which displacements are also found from frame 1 to frame 0."""
    row, column, is_inside = _target_pixels(forward)
    reverse = backward[row, column]
    disagreement = np.hypot(*cv2.split(forward[..., :2] + reverse[..., :2]))
    is_match = (
        (forward[..., 2] < PROPOSALS.max_cost)
        & (reverse[..., 2] < UNTEXTURED)
        & (reverse[..., 3] > 0)
    )
    return np.asarray(is_inside & is_match & (disagreement < PROPOSALS.max_disagreement))


def _large_regions(forward: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the pixels of a mask without small regions that have a displacement of their own."""
    for component in cv2.split(forward[..., :2]):
        units = REGION_UNITS * (component - component.min()) + 1
        units = np.where(mask, units, 0).clip(0, np.iinfo(np.int16).max).astype(np.int16)
        cv2.filterSpeckles(units, 0, PROPOSALS.min_region, REGION_UNITS)
        mask = mask & (units > 0)
    return mask


def _fill_flow(
    windows: Windows,
    comparison: ResidualComparison,
    flow: np.ndarray,  # (h, w, 2) float32: px/frame
    is_known: np.ndarray,  # (h, w) bool
    previous: np.ndarray,  # (h, w, 4) float32: state of the previous flow in the search
) -> np.ndarray:
    """Return a flow whose unknown pixels take the nearest known flow, if the images confirm it.

    The images cannot confirm a flow that leaves the image. A pixel takes such a flow if its present
    flow stays inside and does not match, or if it changes too fast (`max_flow_slope`).
    """
    distance = np.where(is_known, 0, np.float32(flow.size)).astype(np.float32)
    proposal = np.zeros((*windows.shape, 4), np.float32)
    proposal[..., :2], proposal[..., 3] = flow, 1
    mean_grey_step = mean_step(windows.grey0, windows.valid0)
    for _ in range(PROPOSALS.fill_passes):
        propagate_flow(
            windows.grey0, distance, proposal, edge=PROPOSALS.edge_distance * mean_grey_step
        )
    windows.search.score(proposal, min_variance=PROPOSALS.min_window_variance)
    windows.mark_invalid(proposal)
    cost = np.where(previous[..., 2] < UNTEXTURED, previous[..., 2], 0)
    is_cheaper = (proposal[..., 2] < cost - PROPOSALS.min_cost_gain) & (
        cost > PROPOSALS.min_filled_cost
    )
    is_cheaper &= comparison.is_better(
        proposal[..., :2], flow, window=PROPOSALS.residual_window, min_gain=PROPOSALS.fill_gain
    )
    distance_px = cv2.distanceTransform((~is_known).astype(np.uint8), cv2.DIST_L2, 3)
    is_broken = (
        np.hypot(*cv2.split(flow - proposal[..., :2])) > PROPOSALS.max_flow_slope * distance_px
    )
    leaves_image = (
        (is_broken | _target_pixels(previous)[2])
        & ~_target_pixels(proposal)[2]
        & (cost > PROPOSALS.min_poor_cost)
    )
    return np.where((~is_known & (is_cheaper | leaves_image))[..., None], proposal[..., :2], flow)
