"""Objects that move far for their size, separated from their surroundings in a flow field.

The smoothness term of a flow charges every step of motion along an outline, without a bound. A
small object that moves far therefore costs less if it moves with its surroundings, even if the
images show the opposite. Once the images have shown such an object, the smoothness is cut along its
outline, and the outline is searched again on every level, by the images alone.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from tisfm.kernels.data.image_edges import image_edges
from tisfm.kernels.layout.images import image_to_lanes
from tisfm.kernels.rigid.flow_search import carry
from tisfm.motion.matched_windows import ResidualComparison, Windows
from tisfm.solver.coarse_to_fine import Problem
from tisfm.solver.smoothness import FAINTEST_EDGE, mean_step
from tisfm.solver.unknowns import Unknowns

# All of these were set by hand.
OUTSIDE_MARGIN = 5  # px outside a known outline within which the outline is searched
INSIDE_MARGIN = 2  # px inside a known outline within which the outline is searched
WINDOW = 3  # px: side of the square whose residuals assign a pixel to object or surroundings
OUTLINE_ROUNDS = 3  # searches of an outline, each from the one before
FILL_PASSES = 2  # passes along rows and columns that fill a flow from known pixels
# Mean steps of the frame that are added to grey levels of objects: no smoothness crosses the edge.
EDGE_HEIGHT = 1e6
STENCIL_REACH = 3  # px that differences and means reach
SEARCH_REACH = OUTLINE_ROUNDS * OUTSIDE_MARGIN + STENCIL_REACH  # px around an object

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
        windows: Windows,  # windows of that level
        unknowns: Unknowns,  # ρ̂ near the outlines is overwritten, and so are their `edges`
    ) -> None:
        """Find the outlines on a level, and cut the smoothness along them."""
        self._mask = _resize_mask(self._mask, windows.shape)
        self._update_outlines(windows, unknowns)
        step = max(mean_step(windows.grey0, windows.counted0), FAINTEST_EDGE)
        grey = windows.grey0.copy()
        grey[self._mask] += np.float32(EDGE_HEIGHT * step)
        rate = self._problem.smoothness.image_edges / step
        image_edges(unknowns.grid, grey, unknowns.edges, rate=rate)

    def _update_outlines(self, windows: Windows, unknowns: Unknowns) -> None:
        """Find each outline in its part of the image, and overwrite ρ̂ near the outlines."""
        flow, changes = unknowns.flow(), []
        for part, is_near in _object_parts(self._mask, flow):
            previous = improved = cv2.merge(list(flow[:, part[0], part[1]]))
            mask = self._mask[part] & is_near
            comparison = ResidualComparison(windows.crop(part), self._problem.constancy)
            for _ in range(OUTLINE_ROUNDS):
                mask, improved = _improve_outline(comparison, mask, improved)
            self._mask[part] = np.where(is_near, mask, self._mask[part])
            changes.append((part, np.where(is_near[..., None], improved - previous, 0)))
        del flow
        for component in range(2):
            rho = unknowns.to_image(unknowns.rho, component)
            for part, change in changes:
                rho[part] += change[..., component]
            image_to_lanes(unknowns.grid, rho, unknowns.rho, component=component)


def _resize_mask(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a mask on a finer level, or a copy where the level is the same."""
    if mask.shape == shape:
        return mask.copy()
    size = shape[::-1]
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5


def _object_parts(mask: np.ndarray, flow: np.ndarray) -> Iterator[tuple[Part, np.ndarray]]:
    """Yield, for each object, the part of the image that it crosses and the pixels near it.

    The pixels, (h, w) bool of that part, are the surroundings to which no other object is nearer.
    """
    dilated = cv2.dilate(mask.astype(np.uint8), _square(SEARCH_REACH))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(dilated, connectivity=8)
    for label in range(1, count):
        left, top, width, height, _ = boxes[label]
        u, v = flow[:, top : top + height, left : left + width]
        part = (
            _range_with_motion(top, top + height, v, mask.shape[0]),
            _range_with_motion(left, left + width, u, mask.shape[1]),
        )
        yield part, labels[part] == label


def _range_with_motion(first: int, end: int, motion: np.ndarray, length: int) -> slice:
    """Return the pixels from the first to the end along an axis, and those they move to."""
    lowest, highest = first + motion.min() - STENCIL_REACH, end + motion.max() + STENCIL_REACH
    first, end = (
        int(np.clip(position, 0, length)) for position in (min(first, lowest), max(end, highest))
    )
    return slice(first, end)


def _improve_outline(
    comparison: ResidualComparison, mask: np.ndarray, flow: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return an improved mask of an object, and the flow that follows from it."""
    previous = mask.astype(np.uint8)
    outer = cv2.dilate(previous, _square(OUTSIDE_MARGIN)) > 0
    core = cv2.erode(previous, _square(INSIDE_MARGIN)) > 0
    inside, outside = _fill_nearest(flow, core), _fill_nearest(flow, ~outer)
    improved = core | (outer & comparison.is_better(inside, outside, window=WINDOW))
    _, labels = cv2.connectedComponents(improved.astype(np.uint8), connectivity=4)
    improved = np.isin(labels, np.unique(labels[core]))  # parts without a core are dropped
    new_flow = np.where(improved[..., None], inside, outside)
    return improved, np.where(outer[..., None], new_flow, flow)


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _fill_nearest(flow: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return a flow whose unknown pixels take the flow of the nearest known pixel."""
    distance = np.where(mask, 0, np.float32(mask.size)).astype(np.float32)
    state = np.zeros((*mask.shape, 4), np.float32)
    state[..., :2] = flow
    zeros = np.zeros(mask.shape, np.float32)
    for _ in range(FILL_PASSES):
        carry(zeros, distance, state, edge=1.0)
    return state[..., :2].copy()
