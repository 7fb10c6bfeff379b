"""A field of signed distances, in blocks near the surface that views show."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats
from tisfm.fusion.depth_views import PosedDepth, Views

MOST_BLOCKS = 150_000  # of 6 KB each
MOST_CANDIDATES = 16 * MOST_BLOCKS  # of 12 bytes each
_ROWS = 64  # that are looked through at a time
_ACROSS = 3  # pixels that are looked at, at least, across a block
_MOST_STEPS = 8  # from one to the next, px: where blocks are large
_APART = 4.0  # voxels between places of a ray that are looked at
_MOST_PLACES = 101  # of a ray
_BITS = 17  # of a block's coordinate, so that a voxel's has 20
_HALF = 2 ** (_BITS - 1)

Blocks = NDArray[np.int64]


class TooFineError(Exception):
    """Voxels of this size would be too many.

    Attributes
    ----------
    larger : float
        By how much the voxels must be larger, at least, as far as can be told.
    """

    def __init__(self, larger: float) -> None:
        super().__init__(f"voxels must be {larger:g} times as large")
        self.larger = larger


@dataclass(frozen=True, kw_only=True, eq=False)
class Field:
    """A truncated field of signed distances.

    Attributes
    ----------
    voxel : float
        Edge of a voxel.
    numbers : (N,) int64
        Of the blocks, ascending (`coordinates`).
    distance : (N, 512) float32
        Mean distance before the surface, in truncations, in [−1, 1].
    views : (N, 512) int32
        How many views show the surface nearby.
    """

    voxel: float
    numbers: Blocks
    distance: NDArray[np.float32]
    views: NDArray[np.int32]


def coordinates(numbers: Blocks) -> NDArray[np.int64]:
    """Return (N, 3), where blocks lie, in blocks from the world's origin."""
    mask = 2**_BITS - 1
    return np.stack([(numbers >> (shift * _BITS)) & mask for shift in (2, 1, 0)], axis=1) - _HALF


def numbers_of(blocks: NDArray[np.int64]) -> Blocks:
    """Return the numbers of blocks at (…, 3)."""
    x, y, z = np.moveaxis(blocks + _HALF, -1, 0)
    return (((x << _BITS) | y) << _BITS) | z


def field_of(views: Views, voxel: float, truncation: float, agreeing: int) -> Field:
    """Take all views into a field.

    Parameters
    ----------
    views : Views
        They are read twice.
    voxel, truncation : float
        In the views' unit.
    agreeing : int
        How many views must come near to a block; others are left out.

    Raises
    ------
    TooFineError
        If there would be too many blocks.
    """
    from tisfm.kernels.fusion.distance_field import VOXELS

    numbers = _blocks(views, voxel, truncation, agreeing)
    distance = np.ones((len(numbers), VOXELS), np.float32)
    weight = np.zeros((len(numbers), VOXELS), np.float32)
    count = np.zeros((len(numbers), VOXELS), np.int32)
    for view in views:
        _integrate(view, voxel, truncation, numbers, distance, weight, count)
    return Field(voxel=voxel, numbers=numbers, distance=distance, views=count)


def _blocks(views: Views, voxel: float, truncation: float, agreeing: int) -> Blocks:
    """Return the numbers of the blocks that enough views come near to, ascending.

    Mistakes of single views would be many more.
    """
    numbers, count = np.empty(0, np.int64), np.empty(0, np.int32)
    for view, seen in zip(views, views.seen, strict=True):
        near = _blocks_near(view, seen.farthest, voxel, truncation)
        both = np.union1d(numbers, near)
        counted = np.zeros(len(both), np.int32)
        counted[np.searchsorted(both, numbers)] = count
        new = np.searchsorted(both, near)
        counted[new] += 1
        numbers, count = both, counted
        if len(numbers) > MOST_CANDIDATES:
            kept = count >= min(agreeing, 2)
            kept[new] = True  # others may follow
            numbers, count = numbers[kept], count[kept]
        if len(numbers) > MOST_CANDIDATES:
            raise TooFineError(np.sqrt(len(numbers) / MOST_BLOCKS))
    numbers = numbers[count >= agreeing]
    if len(numbers) > MOST_BLOCKS:
        raise TooFineError(np.sqrt(len(numbers) / MOST_BLOCKS))
    return numbers


def _blocks_near(view: PosedDepth, farthest: float, voxel: float, truncation: float) -> Blocks:
    """Return the numbers of the blocks that a view's surface comes near to, ascending.

    Of the pixels as many are looked at as the smallest block in the image needs.
    """
    from tisfm.kernels.fusion.distance_field import CORNERS, EDGE, blocks_near

    edge = EDGE * voxel
    low, high = _bounds(view, farthest + truncation, 2 * voxel)
    first = np.floor(low / edge)
    extent = np.floor(high / edge) - first + 1
    if np.abs([first, first + extent]).max() >= _HALF - 1 or extent.prod() >= 2**31:
        too_many = np.cbrt(extent.prod() / 2**31)
        too_far = np.abs([first, first + extent]).max() / (_HALF - 1)
        raise TooFineError(1.01 * max(too_many, too_far))
    places = 1 + 2 * int(np.ceil(truncation / (_APART * voxel)))
    if places > _MOST_PLACES:
        raise TooFineError(places / _MOST_PLACES)
    nx, ny, nz = extent.astype(int).tolist()
    across = edge * view.intrinsics[0, 0] / farthest
    step = int(np.clip(across / _ACROSS, 1, _MOST_STEPS))
    rays = view.to_world / voxel
    rays[:, 3] -= first * EDGE
    height, width = view.inverse_depth.shape
    found = []
    for top in range(0, height, _ROWS * step):
        rows = -(-min(height - top, _ROWS * step) // step)
        near = np.empty((rows, -(-width // step), places, CORNERS), np.int32)
        blocks_near(
            view.inverse_depth,
            view.deviation,
            near,
            top=top,
            stride=step,
            rays=rays.astype(np.float32),
            extent=(nx, ny, nz),
            truncation=truncation,
        )
        # Most pixels come near to the same blocks as the one to their left.
        new = near >= 0
        new[:, 1:] &= near[:, 1:] != near[:, :-1]
        found.append(np.unique(near[new]))
    flat = np.unique(np.concatenate(found)).astype(np.int64)
    blocks = np.stack([flat // (ny * nz), flat // nz % ny, flat % nz], axis=1)
    return np.sort(numbers_of(blocks + first.astype(np.int64)))


def _bounds(view: PosedDepth, farthest: float, margin: float) -> tuple[Floats, Floats]:
    """Return the least and the greatest coordinates of what a view may see, and a margin beyond."""
    height, width = view.inverse_depth.shape
    corners = np.array([(x, y, 1) for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    rays = view.to_world
    ends = np.vstack([corners @ rays[:, :3].T * farthest, np.zeros(3)]) + rays[:, 3]
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
    """Take a view into the field's arrays, which are modified."""
    from tisfm.kernels.fusion.distance_field import EDGE, integrate

    to_pixels = view.to_pixels
    corners = coordinates(numbers) * (EDGE * voxel) @ to_pixels[:, :3].T + to_pixels[:, 3]
    steps = np.ascontiguousarray(voxel * to_pixels[:, :3].T)
    index = np.flatnonzero(_may_be_seen(view, corners, steps * (EDGE - 1), truncation))
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


def _may_be_seen(
    view: PosedDepth, corners: Floats, across: Floats, truncation: float
) -> NDArray[np.bool_]:
    """Return which blocks have a corner on each inner side of the view's bounds.

    Parameters
    ----------
    corners : (N, 3) float64
        (u z, v z, z) of the first voxel of each block.
    across : (3, 3) float64
        What the last voxel along each axis adds.
    """
    height, width = view.inverse_depth.shape
    farthest = 1 / view.inverse_depth[view.inverse_depth > 0].min() + truncation
    sides = np.array(  # each is positive inside
        [
            [1, 0, 0.5],
            [-1, 0, width - 0.5],
            [0, 1, 0.5],
            [0, -1, height - 0.5],
            [0, 0, 1],
        ]
    )
    reach = np.maximum(across @ sides.T, 0).sum(axis=0)
    inside = (corners @ sides.T + reach >= 0).all(axis=1)
    return inside & (corners[:, 2] + np.minimum(across[:, 2], 0).sum() <= farthest)
