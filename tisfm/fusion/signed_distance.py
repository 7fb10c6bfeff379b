"""A truncated signed distance field, stored in blocks near the surface."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats
from tisfm.fusion.depth_views import PosedDepth, PosedViews

MAX_BLOCKS = 150_000  # blocks of a field, 6 KB each: 0.9 GB
MAX_CANDIDATES = 16 * MAX_BLOCKS  # blocks while views are counted, 12 bytes each
# Sampling of a view's rays for the blocks near its surface; set by hand:
_BAND_ROWS = 64  # rows of sampled pixels that are processed at a time
_SAMPLES_PER_BLOCK = 3  # smallest number of pixels sampled across a block in the image
_MAX_PIXEL_STEP = 8  # px between sampled pixels, for large blocks
_RAY_STEP = 4.0  # voxels between the sampled points of a ray
_MAX_RAY_SAMPLES = 101  # sampled points of a ray
_BITS = 17  # bits of a block coordinate, so that a voxel coordinate has 20
_OFFSET = 2 ** (_BITS - 1)  # added to a block coordinate: the sum is not negative

Blocks = NDArray[np.int64]
"""Block numbers: three coordinates of `_BITS` bits each."""


class VoxelTooSmallError(Exception):
    """The field would need too many voxels of this size."""

    def __init__(
        self,
        factor: float,  # estimate of the smallest factor by which the voxels must be larger
    ) -> None:
        super().__init__(f"voxels must be {factor:g} times as large")
        self.factor = factor


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceField:
    """A truncated signed distance field."""

    voxel: float  # edge of a voxel
    numbers: Blocks  # (N,) int64: numbers of the blocks, ascending (`block_coordinates`)
    # (N, 512) float32: mean signed distance from the surface, in truncation distances, from −1
    # (behind the surface) to 1 (in front of it)
    distance: NDArray[np.float32]
    views: NDArray[np.int32]  # (N, 512) int32: number of views that show the surface near the voxel


def block_coordinates(numbers: Blocks) -> NDArray[np.int64]:
    """Return the coordinates of blocks, (N, 3), in blocks from the world's origin."""
    mask = 2**_BITS - 1
    return np.stack([(numbers >> (shift * _BITS)) & mask for shift in (2, 1, 0)], axis=1) - _OFFSET


def block_numbers(blocks: NDArray[np.int64]) -> Blocks:
    """Return the numbers of blocks at the coordinates (…, 3)."""
    x, y, z = np.moveaxis(blocks + _OFFSET, -1, 0)
    return (((x << _BITS) | y) << _BITS) | z


def integrate_views(
    views: PosedViews,  # they are read twice
    # voxel, truncation: edge of a voxel and truncation distance, in the unit of the views
    voxel: float,
    truncation: float,
    # number of views whose surface must come near a block; other blocks are left out
    agreeing: int,
) -> DistanceField:
    """Integrate all views into a field.

    Raises VoxelTooSmallError if there would be too many blocks.
    """
    from tisfm.kernels.fusion.distance_field import VOXELS

    numbers = _select_blocks(views, voxel, truncation, agreeing)
    distance = np.ones((len(numbers), VOXELS), np.float32)
    weight = np.zeros((len(numbers), VOXELS), np.float32)
    count = np.zeros((len(numbers), VOXELS), np.int32)
    for view in views:
        _integrate(view, voxel, truncation, numbers, distance, weight, count)
    return DistanceField(voxel=voxel, numbers=numbers, distance=distance, views=count)


def _select_blocks(views: PosedViews, voxel: float, truncation: float, agreeing: int) -> Blocks:
    """Return the numbers of the blocks near the surfaces of enough views, ascending.

    Errors of single views would add many more blocks.
    """
    numbers, count = np.empty(0, np.int64), np.empty(0, np.int32)
    for view, summary in zip(views, views.summaries, strict=True):
        view_numbers = _find_near_blocks(view, summary.max_z, voxel, truncation)
        all_numbers = np.union1d(numbers, view_numbers)
        view_counts = np.zeros(len(all_numbers), np.int32)
        view_counts[np.searchsorted(all_numbers, numbers)] = count
        view_indices = np.searchsorted(all_numbers, view_numbers)
        view_counts[view_indices] += 1
        numbers, count = all_numbers, view_counts
        if len(numbers) > MAX_CANDIDATES:
            is_kept = count >= min(agreeing, 2)
            is_kept[view_indices] = True  # later views may add to their counts
            numbers, count = numbers[is_kept], count[is_kept]
        if len(numbers) > MAX_CANDIDATES:
            raise VoxelTooSmallError(np.sqrt(len(numbers) / MAX_BLOCKS))
    numbers = numbers[count >= agreeing]
    if len(numbers) > MAX_BLOCKS:
        raise VoxelTooSmallError(np.sqrt(len(numbers) / MAX_BLOCKS))
    return numbers


def _find_near_blocks(view: PosedDepth, max_z: float, voxel: float, truncation: float) -> Blocks:
    """Return the numbers of the blocks near the surface of a view, ascending.

    Pixels are sampled densely enough for the smallest block in the image.
    """
    from tisfm.kernels.fusion.distance_field import BLOCK_EDGE, CORNERS, find_blocks

    edge = BLOCK_EDGE * voxel
    min_corner, max_corner = _view_bounds(view, max_z + truncation, 2 * voxel)
    first_block = np.floor(min_corner / edge)
    extent = np.floor(max_corner / edge) - first_block + 1
    if np.abs([first_block, first_block + extent]).max() >= _OFFSET - 1 or extent.prod() >= 2**31:
        count_factor = np.cbrt(extent.prod() / 2**31)
        range_factor = np.abs([first_block, first_block + extent]).max() / (_OFFSET - 1)
        raise VoxelTooSmallError(1.01 * max(count_factor, range_factor))
    samples = 1 + 2 * int(np.ceil(truncation / (_RAY_STEP * voxel)))
    if samples > _MAX_RAY_SAMPLES:
        raise VoxelTooSmallError(samples / _MAX_RAY_SAMPLES)
    nx, ny, nz = extent.astype(int).tolist()
    block_pixels = edge * view.intrinsics[0, 0] / max_z
    step = int(np.clip(block_pixels / _SAMPLES_PER_BLOCK, 1, _MAX_PIXEL_STEP))
    rays = view.to_world / voxel
    rays[:, 3] -= first_block * BLOCK_EDGE
    height, width = view.inverse_depth.shape
    numbers_of_rows = []
    for top in range(0, height, _BAND_ROWS * step):
        rows = -(-min(height - top, _BAND_ROWS * step) // step)
        row_numbers = np.empty((rows, -(-width // step), samples, CORNERS), np.int32)
        find_blocks(
            view.inverse_depth,
            view.deviation,
            row_numbers,
            top=top,
            stride=step,
            rays=rays.astype(np.float32),
            extent=(nx, ny, nz),
            truncation=truncation,
        )
        # Most pixels are near the same blocks as the pixel to their left.
        is_first = row_numbers >= 0
        is_first[:, 1:] &= row_numbers[:, 1:] != row_numbers[:, :-1]
        numbers_of_rows.append(np.unique(row_numbers[is_first]))
    index = np.unique(np.concatenate(numbers_of_rows)).astype(np.int64)
    blocks = np.stack([index // (ny * nz), index // nz % ny, index % nz], axis=1)
    return np.sort(block_numbers(blocks + first_block.astype(np.int64)))


def _view_bounds(view: PosedDepth, max_z: float, margin: float) -> tuple[Floats, Floats]:
    """Return the smallest and greatest coordinates of the space that a view sees, with a margin."""
    height, width = view.inverse_depth.shape
    corners = np.array([(x, y, 1) for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    rays = view.to_world
    ends = np.vstack([corners @ rays[:, :3].T * max_z, np.zeros(3)]) + rays[:, 3]
    return ends.min(axis=0) - margin, ends.max(axis=0) + margin


def _integrate(
    view: PosedDepth,
    voxel: float,
    truncation: float,
    numbers: Blocks,
    distance: NDArray[np.float32],
    weight: NDArray[np.float32],
    count: NDArray[np.int32],
) -> None:
    """Integrate a view into the arrays of the field, which are modified in place."""
    from tisfm.kernels.fusion.distance_field import BLOCK_EDGE, integrate

    to_pixels = view.to_pixels
    corners = (
        block_coordinates(numbers) * (BLOCK_EDGE * voxel) @ to_pixels[:, :3].T + to_pixels[:, 3]
    )
    steps = np.ascontiguousarray(voxel * to_pixels[:, :3].T)
    index = np.flatnonzero(_blocks_in_frustum(view, corners, steps * (BLOCK_EDGE - 1), truncation))
    integrate(
        view.inverse_depth,
        view.deviation,
        corners[index].astype(np.float32),
        index.astype(np.int32),
        distance,
        weight,
        count,
        steps=steps.astype(np.float32),
        truncation=truncation,
        spread=voxel / 2,
    )


def _blocks_in_frustum(
    view: PosedDepth,
    corners: Floats,  # (N, 3) float64: (u z, v z, z) of the first voxel of each block
    # (3, 3) float64: difference of (u z, v z, z) from the first to the last voxel, along each axis
    block_extent: Floats,
    truncation: float,
) -> NDArray[np.bool_]:
    """Return which blocks may intersect the frustum of a view."""
    height, width = view.inverse_depth.shape
    max_z = 1 / view.inverse_depth[view.inverse_depth > 0].min() + truncation
    planes = np.array(  # each is positive inside
        [[1, 0, 0.5], [-1, 0, width - 0.5], [0, 1, 0.5], [0, -1, height - 0.5], [0, 0, 1]]
    )
    extent = np.maximum(block_extent @ planes.T, 0).sum(axis=0)
    is_inside = (corners @ planes.T + extent >= 0).all(axis=1)
    return is_inside & (corners[:, 2] + np.minimum(block_extent[:, 2], 0).sum() <= max_z)
