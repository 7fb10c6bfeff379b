"""Depth of a keyframe beside its outlines, from small windows.

Windows that are large enough for weak texture give the depth of a nearer surface to the strip
behind its contour. Beside jumps of depth, every pixel is compared alone, by a census transform of
5×5 pixels, in the frames that see it best; semi-global aggregation makes up for the small window.
Away from jumps depth stays as it is, and holds the labels at the ends of the paths. Last, a
weighted median replaces depth at jumps by that of neighbours with a similar grey level.
"""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.kernels.rigid.outline_sweep import MAX_BEST, census_transform, outline_cost
from tisfm.kernels.rigid.semi_global import UNUSED_COST, aggregate, best_hypothesis
from tisfm.kernels.rigid.weighted_median import weighted_median
from tisfm.reconstruction.depth.settings import OUTLINES
from tisfm.runtime import lanes


def search_outlines(
    key: np.ndarray,  # (H, W) float32: grey levels of the keyframe
    others: Sequence[np.ndarray],  # sequence of (H, W) float32: M other frames
    motions: np.ndarray,  # (M, 3, 4): R, t from the keyframe to each other frame
    camera: Camera,  # a pinhole
    inverse_depth: np.ndarray,  # (H, W) float32: 1/unit of the motions; positive
    *,
    cell_side: int,  # px: side of the cells whose depth this is
    key_mask: np.ndarray | None = None,  # (H, W) bool: used pixels; the others keep their depth
    masks: Sequence[np.ndarray | None] | None = None,  # the same for each other frame
) -> np.ndarray:  # (H, W) float32
    """Return the inverse depth of a keyframe, matched again beside jumps of depth."""
    shape = key.shape
    halvings = 0
    while key.size >> 2 * halvings > OUTLINES.max_pixels and min(shape) >> halvings > 1:
        halvings += 1
    size = shape[1] >> halvings, shape[0] >> halvings

    def shrink(image: np.ndarray) -> np.ndarray:
        if not halvings:
            return np.array(image, np.float32)  # kernels need a writable array
        cut = image[: size[1] << halvings, : size[0] << halvings]
        return cv2.resize(cut.astype(np.float32), size, interpolation=cv2.INTER_AREA)

    depth = shrink(inverse_depth)
    radius = min(OUTLINES.jump_cells * cell_side, OUTLINES.max_jump_distance) >> halvings
    is_used = np.ones(depth.shape, bool) if key_mask is None else shrink(key_mask) == 1
    is_searched = is_used & _find_jumps(depth, radius, OUTLINES.min_jump)
    if not is_searched.any():
        return inverse_depth
    codes = [
        _census(shrink(frame), None if mask is None else shrink(mask) == 1)
        for frame, mask in zip(
            others, [None] * len(others) if masks is None else masks, strict=True
        )
    ]
    small_camera = camera.scaled(0.5**halvings, *shape) if halvings else camera
    small_key = shrink(key)
    sweep = _Sweep(small_key, np.stack(codes), motions, small_camera, depth, is_searched, radius)
    found, is_sharpened = _sharpen(sweep.search(), small_key, is_searched, is_used)
    is_changed = sweep.is_changed | is_sharpened
    if halvings:
        found, is_changed = (_enlarge(image, 2**halvings, shape) for image in (found, is_changed))
    return np.where(is_changed, found, inverse_depth)


class _Sweep:
    """The costs of all inverse depths beside jumps, block by block."""

    def __init__(
        self,
        key: np.ndarray,  # (h, w) float32
        census1: np.ndarray,  # (M, h, w) int32
        motions: np.ndarray,  # (M, 3, 4)
        camera: Camera,
        depth: np.ndarray,  # (h, w) float32
        is_searched: np.ndarray,  # (h, w) bool
        radius: int,  # px: distance of the jumps beside which depth is searched
    ) -> None:
        lengths = np.linalg.norm(motions[:, :, 3], axis=1)
        self._unit = float(lengths.max())
        self._key, self._census1, self._camera = key, census1, camera
        self._census0 = _census(key, None)
        self._motions = np.array(motions, np.float32)
        self._motions[:, :, 3] /= np.float32(self._unit)
        # D in px of the frame with the longest baseline
        self._scale = np.float32(self._unit * camera.focal)
        self._depth, self._is_searched = depth * self._scale, is_searched
        # A block may have a surface of the jump beside it alone: both give its range.
        self._limits = _limits(self._depth, radius)
        # (h, w) bool: pixels whose depth the search changed
        self.is_changed = np.zeros(depth.shape, bool)

    def search(self) -> np.ndarray:
        """Return the inverse depth, (h, w) float32; it is new where `is_changed`."""
        found = self._depth.copy()
        for outer, inner in self._blocks():
            block, step = self._search_block(outer)
            rows, columns = (
                slice(part.start - whole.start, part.stop - whole.start)
                for part, whole in zip(inner, outer, strict=True)
            )
            new, old = block[rows, columns], self._depth[inner]
            # On the same surface, the old depth is more exact.
            min_change = np.maximum(step / 2, OUTLINES.min_change * old)
            is_changed = self._is_searched[inner] & (np.abs(new - old) > min_change)
            self.is_changed[inner] = is_changed
            found[inner][is_changed] = new[is_changed]
        return found / self._scale

    def _blocks(self) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
        """Yield the rows and columns of blocks with jumps, with a margin and without it."""
        height, width = self._depth.shape
        side, margin = OUTLINES.block_side, OUTLINES.block_margin
        for top in range(0, height, side):
            for left in range(0, width, side):
                inner = slice(top, min(top + side, height)), slice(left, min(left + side, width))
                if self._is_searched[inner].any():
                    outer = tuple(
                        slice(max(0, part.start - margin), min(part.stop + margin, length))
                        for part, length in zip(inner, (height, width), strict=True)
                    )
                    yield (outer[0], outer[1]), inner

    def _search_block(self, block: tuple[slice, slice]) -> tuple[np.ndarray, float]:
        """Return D of a block with its margin, (h, w) float32, and the step between hypotheses."""
        guess = np.ascontiguousarray(self._depth[block])
        low, high = (
            float(factor * limit)
            for factor, limit in zip(
                OUTLINES.range_factors,
                (self._limits[0][block].min(), self._limits[1][block].max()),
                strict=True,
            )
        )
        count = int(np.clip(np.ceil((high - low) / OUTLINES.step), 2, OUTLINES.max_hypotheses))
        step, lane_count = (high - low) / (count - 1), lanes()
        vectors = -(-count // lane_count)
        shape = guess.shape
        plain = (*shape, vectors * lane_count)
        cost = aligned_empty((*shape, vectors, lane_count) if lane_count > 1 else plain)
        outline_cost(
            self._census0,
            self._census1,
            self._motions,
            guess,
            self._is_searched[block].astype(np.int32),
            cost,
            origin=(block[0].start, block[1].start),
            center=self._camera.center_for(*self._key.shape),
            focal=self._camera.focal,
            first=low,
            step=step,
            best_count=min((len(self._motions) + 1) // 2, MAX_BEST),
            guess_costs=(OUTLINES.guess_cost, OUTLINES.fixed_cost),
            guess_distances=(
                OUTLINES.guess_range * (high - low),
                OUTLINES.fixed_steps * step,
            ),
        )
        cost.reshape(plain)[..., count:] = UNUSED_COST
        total = aligned_empty(cost.shape)
        aggregate(
            cost,
            np.ascontiguousarray(self._key[block]),
            total,
            step=OUTLINES.step_cost,
            jump=OUTLINES.jump_cost,
            edge=OUTLINES.edge,
        )
        best = np.empty(shape, np.float32)
        best_hypothesis(total.reshape(plain), best, count=count)
        return cv2.medianBlur(np.float32(low + step * best), OUTLINES.median_window), step


def _sharpen(
    depth: np.ndarray,  # (h, w) float32
    key: np.ndarray,  # (h, w) float32
    is_searched: np.ndarray,  # (h, w) bool
    is_used: np.ndarray,  # (h, w) bool: pixels whose depth counts
) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse depth with outlines at edges of the image, and the changed pixels, bool."""
    is_beside = is_searched & _find_jumps(depth, OUTLINES.sharpening_radius, OUTLINES.min_jump)
    median = np.empty_like(depth)
    weighted_median(
        depth,
        key,
        is_beside.astype(np.int32),
        is_used.astype(np.int32),
        median,
        radius=OUTLINES.sharpening_radius,
        grey_scale=OUTLINES.sharpening_scale,
        same_share=OUTLINES.min_surface_step,
        max_own_weight=OUTLINES.max_own_weight,
    )
    # A smaller difference is the slope of one surface, which stays.
    is_changed = np.abs(median - depth) > OUTLINES.min_surface_step * depth
    return np.where(is_changed, median, depth), is_changed


def _find_jumps(depth: np.ndarray, radius: int, min_jump: float) -> np.ndarray:
    """Return the pixels beside jumps of depth, (h, w) bool."""
    low, high = _limits(depth, radius)
    return np.asarray(high - low > min_jump * depth)


def _limits(depth: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest depth in a window around every pixel, (h, w) each."""
    square = np.ones((2 * radius + 1,) * 2, np.uint8)
    return np.asarray(cv2.erode(depth, square)), np.asarray(cv2.dilate(depth, square))


def _census(frame: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Return the census transform of a frame, (h, w) int32; `mask`, (h, w) bool: used pixels."""
    codes = np.empty(frame.shape, np.int32)
    is_used = np.ones(frame.shape, np.int32) if mask is None else mask.astype(np.int32)
    census_transform(np.ascontiguousarray(frame), is_used, codes)
    return codes


def _enlarge(image: np.ndarray, factor: int, shape: tuple[int, int]) -> np.ndarray:
    """Return an image with `shape`, each pixel repeated; the last rows and columns go on."""
    large = image.repeat(factor, axis=0).repeat(factor, axis=1)
    missing = [(0, length - part) for length, part in zip(shape, large.shape, strict=True)]
    return np.pad(large, missing, mode="edge")
