"""Depth of a keyframe beside its outlines, from small windows.

Windows that are large enough for weak texture give the depth of a nearer surface to the strip
behind its contour. Beside jumps of depth, every pixel is compared alone, by a census transform of
5×5 pixels, in the frames that see it best; semi-global aggregation makes up for the small window.
Away from jumps depth stays as it is, and holds the labels at the ends of the paths.
"""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.kernels.rigid.outline_sweep import MAX_BEST, census_transform, outline_cost
from tisfm.kernels.rigid.semi_global import UNUSED_COST, aggregate, best_hypothesis
from tisfm.reconstruction.depth.settings import OUTLINES
from tisfm.runtime import lanes


def search_outlines(
    key: np.ndarray,  # (H, W) float32: grey levels of the keyframe
    others: Sequence[np.ndarray],  # sequence of (H, W) float32: M other frames
    motions: np.ndarray,  # (M, 3, 4): R, t from the keyframe to each other frame
    camera: Camera,  # a pinhole
    inverse_depth: np.ndarray,  # (H, W) float32: 1/unit of the motions; positive
    *,
    key_mask: np.ndarray | None = None,  # (H, W) bool: used pixels; the others keep their depth
    masks: Sequence[np.ndarray | None] | None = None,  # the same for each other frame
) -> np.ndarray:  # (H, W) float32
    """Return the inverse depth of a keyframe, matched again beside jumps of depth."""
    shape = key.shape
    halvings = 0
    while key.size >> 2 * halvings > OUTLINES.max_pixels:
        halvings += 1
    size = shape[1] >> halvings, shape[0] >> halvings

    def shrink(image: np.ndarray) -> np.ndarray:
        if not halvings:
            return np.array(image, np.float32)  # kernels need a writable array
        cut = image[: size[1] << halvings, : size[0] << halvings]
        return cv2.resize(cut.astype(np.float32), size, interpolation=cv2.INTER_AREA)

    depth = shrink(inverse_depth)
    is_free = _find_jumps(depth)
    if key_mask is not None:
        is_free &= shrink(key_mask) > 0
    if not is_free.any():
        return inverse_depth
    small_camera = camera.scaled(0.5**halvings, *shape) if halvings else camera
    all_masks = masks or [None] * len(others)
    sweep = _Sweep(
        shrink(key),
        np.stack(
            [
                _census(shrink(frame), None if mask is None else shrink(mask) > 0)
                for frame, mask in zip(others, all_masks, strict=True)
            ]
        ),
        motions,
        small_camera,
        depth,
        is_free,
    )
    found = sweep.search()
    if not halvings:
        return found
    is_changed = _enlarge(is_free.astype(np.float32), shape) > 0
    return np.where(is_changed, _enlarge(found, shape), inverse_depth)


class _Sweep:
    """The costs of all inverse depths beside jumps, block by block."""

    def __init__(
        self,
        key: np.ndarray,  # (h, w) float32
        census1: np.ndarray,  # (M, h, w) int32
        motions: np.ndarray,  # (M, 3, 4)
        camera: Camera,
        depth: np.ndarray,  # (h, w) float32
        is_free: np.ndarray,  # (h, w) bool
    ) -> None:
        lengths = np.linalg.norm(motions[:, :, 3], axis=1)
        self._unit = float(lengths.max())
        self._key, self._census1, self._camera = key, census1, camera
        self._census0 = _census(key, None)
        self._motions = np.array(motions, np.float32)
        self._motions[:, :, 3] /= np.float32(self._unit)
        # D in px of the frame with the longest baseline
        self._scale = np.float32(self._unit * camera.focal)
        self._inverse_depth, self._is_free = depth, is_free
        self._depth = depth * self._scale
        low, high = np.percentile(self._depth, (1, 99))
        self._low = float(OUTLINES.range_factors[0] * low)
        self._high = float(OUTLINES.range_factors[1] * high)
        count = np.ceil((self._high - self._low) / OUTLINES.step)
        self._count = int(np.clip(count, 2, OUTLINES.max_hypotheses))
        self._step = (self._high - self._low) / (self._count - 1)

    def search(self) -> np.ndarray:
        """Return the inverse depth, (h, w) float32."""
        found = self._inverse_depth.copy()
        for outer, inner in self._blocks():
            block = self._search_block(outer)
            rows, columns = (
                slice(part.start - whole.start, part.stop - whole.start)
                for part, whole in zip(inner, outer, strict=True)
            )
            is_free = self._is_free[inner]
            found[inner][is_free] = block[rows, columns][is_free] / self._scale
        return found

    def _blocks(self) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
        """Yield the rows and columns of blocks with jumps, with a margin and without it."""
        height, width = self._depth.shape
        side, margin = OUTLINES.block_side, OUTLINES.block_margin
        for top in range(0, height, side):
            for left in range(0, width, side):
                inner = slice(top, min(top + side, height)), slice(left, min(left + side, width))
                if self._is_free[inner].any():
                    outer = tuple(
                        slice(max(0, part.start - margin), min(part.stop + margin, length))
                        for part, length in zip(inner, (height, width), strict=True)
                    )
                    yield (outer[0], outer[1]), inner

    def _search_block(self, block: tuple[slice, slice]) -> np.ndarray:
        """Return D of a block with its margin, (h, w) float32."""
        guess = np.ascontiguousarray(self._depth[block])
        low, high = OUTLINES.range_factors[0] * guess.min(), OUTLINES.range_factors[1] * guess.max()
        low, high = max(low, self._low), min(high, self._high)
        begin = int(max(0, (low - self._low) // self._step))
        end = int(min(self._count, (high - self._low) // self._step + 2))
        count, lane_count = max(2, end - begin), lanes()
        vectors = -(-count // lane_count)
        shape = guess.shape
        plain = (*shape, vectors * lane_count)
        cost = aligned_empty((*shape, vectors, lane_count) if lane_count > 1 else plain)
        first = float(self._low + begin * self._step)
        outline_cost(
            self._census0,
            self._census1,
            self._motions,
            guess,
            self._is_free[block].astype(np.int32),
            cost,
            origin=(block[0].start, block[1].start),
            center=self._camera.center_for(*self._key.shape),
            focal=self._camera.focal,
            first=first,
            step=self._step,
            best_count=min((len(self._motions) + 1) // 2, MAX_BEST),
            guess_costs=(OUTLINES.guess_cost, OUTLINES.fixed_cost),
            guess_distances=(
                OUTLINES.guess_range * (self._high - self._low),
                OUTLINES.fixed_steps * self._step,
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
        return cv2.medianBlur(first + self._step * best, OUTLINES.median_window)


def _find_jumps(depth: np.ndarray) -> np.ndarray:
    """Return the pixels beside jumps of depth, (h, w) bool."""
    square = np.ones((OUTLINES.jump_window,) * 2, np.uint8)
    low, high = cv2.erode(depth, square), cv2.dilate(depth, square)
    return np.asarray(high - low > OUTLINES.min_jump * depth)


def _census(frame: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Return the census transform of a frame, (h, w) int32; `mask`, (h, w) bool: used pixels."""
    codes = np.empty(frame.shape, np.int32)
    is_used = np.ones(frame.shape, np.int32) if mask is None else mask.astype(np.int32)
    census_transform(np.ascontiguousarray(frame), is_used, codes)
    return codes


def _enlarge(image: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return an image with `shape`, each pixel repeated; the last rows and columns go on."""
    factor = shape[0] // image.shape[0]
    large = image.repeat(factor, axis=0).repeat(factor, axis=1)
    missing = [(0, length - part) for length, part in zip(shape, large.shape, strict=True)]
    return np.pad(large, missing, mode="edge")
