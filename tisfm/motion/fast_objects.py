"""Objects that move far for their size, separated from their surroundings in a flow field.

In the smoothness term of a flow, every step of motion along an outline has a cost without a bound.
A small object that moves far therefore costs less if it moves with its surroundings, even if the
images show the opposite. Once the images have shown such an object, the smoothness is cut along its
outline, and the outline is searched again on every level, by the images alone.

Connected areas of a proposed flow count as objects if they pass the tests of this module.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from tisfm.kernels.data.image_edges import image_edges
from tisfm.kernels.layout.images import image_to_lanes
from tisfm.kernels.rigid.flow_search import propagate_flow
from tisfm.kernels.rigid.windows import RADIUS
from tisfm.motion.matched_windows import ResidualComparison, Windows
from tisfm.motion.settings import PROPOSALS
from tisfm.solver.coarse_to_fine import Problem
from tisfm.solver.smoothness import MIN_GREY_STEP, mean_step
from tisfm.solver.unknowns import Unknowns

# Addition to the grey levels of objects, in mean |ΔI|: so no smoothness crosses their outlines.
EDGE_HEIGHT = 1e6
STENCIL_RADIUS = 3  # px: radius of the stencils of differences and means

MAX_SIDE = 2**15 - 2  # px: cv2.remap takes no longer frames
FAR_FLOW = np.float32(MAX_SIDE)  # px: longer than any flow

Part = tuple[slice, slice]  # rows and columns


class FastObjects:
    """Pixels of objects that move on their own, tracked from level to level."""

    def __init__(
        self,
        mask: np.ndarray,  # (h, w) bool: the pixels of the objects, on any level
        problem: Problem,
    ) -> None:
        self._mask, self._problem = mask, problem

    def cut_smoothness(
        self,
        windows: Windows,  # windows of the level
        unknowns: Unknowns,  # their `edges`, and ρ̂ near the outlines, are overwritten
    ) -> None:
        """Find the outlines of the objects on a level, and cut the smoothness along them."""
        self._mask = _resize_mask(self._mask, windows.shape)
        self._update_outlines(windows, unknowns)
        step = max(mean_step(windows.grey0, windows.valid0), MIN_GREY_STEP)
        grey = windows.grey0.copy()
        grey[self._mask] += np.float32(EDGE_HEIGHT * step)
        rate = self._problem.smoothness.image_edges / step
        image_edges(unknowns.grid, grey, unknowns.edges, rate=rate)

    def _update_outlines(self, windows: Windows, unknowns: Unknowns) -> None:
        """Find each outline in its part of the image, and overwrite ρ̂ near the outlines."""
        flow, changes = unknowns.flow(), []
        for part, is_near in _object_parts(self._mask, flow):
            previous_flow = new_flow = cv2.merge(list(flow[:, part[0], part[1]]))
            mask = self._mask[part] & is_near
            comparison = ResidualComparison(windows.crop(part), self._problem.constancy)
            for _ in range(PROPOSALS.outline_rounds):
                mask, new_flow = _improve_outline(comparison, mask, new_flow)
            self._mask[part] = np.where(is_near, mask, self._mask[part])
            changes.append((part, np.where(is_near[..., None], new_flow - previous_flow, 0)))
        del flow
        for component in range(2):
            rho = unknowns.to_image(unknowns.rho, component)
            for part, change in changes:
                rho[part] += change[..., component]
            image_to_lanes(unknowns.grid, rho, unknowns.rho, component=component)


def _resize_mask(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a mask on a finer level, or a copy of a mask on the same level."""
    if mask.shape == shape:
        return mask.copy()
    size = shape[::-1]
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5


def _object_parts(mask: np.ndarray, flow: np.ndarray) -> Iterator[tuple[Part, np.ndarray]]:
    """Yield, for each object, the part of the image that it crosses and the pixels near it.

    The pixels, (h, w) bool in that part, are the surroundings of the object to which no other
    object is nearer.
    """
    reach = PROPOSALS.outline_rounds * PROPOSALS.outside_margin + STENCIL_RADIUS
    dilation = cv2.dilate(mask.astype(np.uint8), _square(reach))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(dilation, connectivity=8)
    for label in range(1, count):
        left, top, width, height, _ = boxes[label]
        u, v = flow[:, top : top + height, left : left + width]
        part = (
            _range_with_motion(top, top + height, v, mask.shape[0]),
            _range_with_motion(left, left + width, u, mask.shape[1]),
        )
        yield part, labels[part] == label


def _range_with_motion(first: int, end: int, motion: np.ndarray, length: int) -> slice:
    """Return the pixels from `first` to `end` along an axis, and the pixels that they move to."""
    start, stop = first + motion.min() - STENCIL_RADIUS, end + motion.max() + STENCIL_RADIUS
    first, end = (
        int(np.clip(position, 0, length)) for position in (min(first, start), max(end, stop))
    )
    return slice(first, end)


def _improve_outline(
    comparison: ResidualComparison, mask: np.ndarray, flow: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return an improved mask of an object, and the flow that follows from it."""
    pixels = mask.astype(np.uint8)
    max_mask = cv2.dilate(pixels, _square(PROPOSALS.outside_margin)) > 0
    min_mask = cv2.erode(pixels, _square(PROPOSALS.inside_margin)) > 0
    object_flow, other_flow = _fill_nearest(flow, min_mask), _fill_nearest(flow, ~max_mask)
    new_mask = min_mask | (
        max_mask & comparison.is_better(object_flow, other_flow, window=PROPOSALS.outline_window)
    )
    _, labels = cv2.connectedComponents(new_mask.astype(np.uint8), connectivity=4)
    # parts without a pixel of `min_mask` are dropped
    new_mask = np.isin(labels, np.unique(labels[min_mask]))
    new_flow = np.where(new_mask[..., None], object_flow, other_flow)
    return new_mask, np.where(max_mask[..., None], new_flow, flow)


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _fill_nearest(flow: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return a flow whose unknown pixels take the flow of the nearest known pixel."""
    distance = np.where(mask, 0, np.float32(mask.size)).astype(np.float32)
    state = np.zeros((*mask.shape, 4), np.float32)
    state[..., :2] = flow
    zeros = np.zeros(mask.shape, np.float32)
    for _ in range(PROPOSALS.outline_fill_passes):
        propagate_flow(zeros, distance, state, edge=1.0)
    return state[..., :2].copy()


def fast_areas(
    is_new: np.ndarray,  # (h, w) bool: pixels with a new displacement
    # forward, previous: (h, w, 4) float32: new and previous states of the flow search
    forward: np.ndarray,
    previous: np.ndarray,
    *,
    min_speed: float,  # px of motion divided by the square root of the area
    min_area: int,  # px
) -> np.ndarray:
    """Return the new pixels of connected areas that move far for their size.

    An area has at least `min_area` pixels. It moves by more than `min_speed` times the square root
    of its size, relative to its previous flow and to the flow of well-matched pixels around it. The
    flow of surfaces without texture is ignored.
    """
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        is_new.astype(np.uint8), connectivity=4
    )
    size = boxes[:, cv2.CC_STAT_AREA]
    is_fast = size >= min_area
    is_fast[0] = False
    if not is_fast.any():
        return np.zeros_like(is_new)
    corner, extent = boxes[is_fast, :2], boxes[is_fast, 2:4]
    left, top = np.maximum(corner.min(axis=0) - RADIUS, 0)
    right, bottom = (corner + extent).max(axis=0) + RADIUS
    part = np.s_[top:bottom, left:right]
    relative_motion = _relative_motion(forward[part], previous[part])
    mean = np.bincount(labels[part].ravel(), relative_motion.ravel(), minlength=count) / np.maximum(
        size, 1
    )
    return (is_fast & (mean > min_speed * np.sqrt(size)))[labels]


def _relative_motion(forward: np.ndarray, previous: np.ndarray) -> np.ndarray:
    """Return the distance of displacements from the range of the flow in their window, px."""
    side = 2 * RADIUS + 1
    window = np.ones((side, side), np.uint8)
    flow, is_matched = previous[..., :2], (previous[..., 2] < PROPOSALS.min_poor_cost)[..., None]
    min_flow = np.minimum(cv2.erode(np.where(is_matched, flow, FAR_FLOW), window), flow)
    max_flow = np.maximum(cv2.dilate(np.where(is_matched, flow, -FAR_FLOW), window), flow)
    excess = np.maximum(min_flow - forward[..., :2], forward[..., :2] - max_flow)
    return np.hypot(*cv2.split(np.maximum(excess, 0)))


def supported_areas(is_new: np.ndarray, is_supported: np.ndarray) -> np.ndarray:
    """Return the connected areas of new pixels that have enough supported pixels."""
    count, labels = cv2.connectedComponents(is_new.astype(np.uint8), connectivity=4)
    has_support = (
        np.bincount(labels[is_new & is_supported], minlength=count) >= PROPOSALS.min_support
    )
    has_support[0] = False
    return has_support[labels]


def _areas(mask: np.ndarray) -> Iterator[tuple[Part, np.ndarray, int]]:
    """Yield the box of each connected area of a mask, the area within it, and its pixel count."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=4
    )
    for label in range(1, count):
        left, top, width, height, size = boxes[label]
        part = slice(top, top + height), slice(left, left + width)
        yield part, labels[part] == label, size


def consistent_pixels(
    is_new: np.ndarray,  # (h, w) bool
    forward: np.ndarray,  # (h, w, 4) float32: new state of the flow search
    is_consistent: np.ndarray,  # (h, w) bool: pixels whose displacement is found in both directions
) -> np.ndarray:
    """Return the new pixels that move like the consistent pixels of their area.

    Areas with too few consistent pixels are dropped.
    """
    result = np.zeros_like(is_new)
    for part, area, size in _areas(is_new):
        is_confirmed = area & is_consistent[part]
        if np.count_nonzero(is_confirmed) > PROPOSALS.min_consistent_share * size:
            motion = forward[part][..., :2]
            difference = motion[area] - np.median(motion[is_confirmed], axis=0)
            result[part][area] = np.hypot(*difference.T) < 2 * PROPOSALS.max_disagreement
    return result


def distinctive_areas(
    is_new: np.ndarray, forward: np.ndarray, previous: np.ndarray, windows: Windows
) -> np.ndarray:
    """Return the areas of new pixels whose motion is unlikely to be a chance match.

    An area has to vary along both directions, since a stripe matches anywhere along itself. It may
    not move too far, since a large search area contains chance matches.
    """
    result = np.zeros_like(is_new)
    if not is_new.any():
        return result
    kernel = np.array([[-0.5, 0, 0.5]], np.float32)
    slope_x, slope_y = (cv2.filter2D(windows.grey0, cv2.CV_32F, k) for k in (kernel, kernel.T))
    for part, area, size in _areas(is_new):
        slopes = np.stack([slope_x[part][area], slope_y[part][area]]).astype(np.float64)
        min_slope = np.linalg.eigvalsh(slopes @ slopes.T / size)[0]
        motion, previous_motion = (
            np.median(state[part][area][:, :2], axis=0) for state in (forward, previous)
        )
        distance = np.hypot(*(motion - previous_motion))
        if (
            min_slope >= PROPOSALS.min_slope * windows.noise** 2
            and distance <= PROPOSALS.max_object_motion * max(windows.shape)
        ):
            result[part] |= area
    return result
