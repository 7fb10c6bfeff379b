"""A field of signed distances, in blocks near the surface that views show."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats
from tisfm.fusion.views import PosedDepth, Views

MOST_BLOCKS = 150_000  # of 6 KB each
_ROWS = 64  # that are looked through at a time
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


def field_of(views: Views, voxel: float, truncation: float) -> Field:
    """Take all views into a field.

    Parameters
    ----------
    views : Views
        They are read twice.
    voxel, truncation : float
        In the views' unit.

    Raises
    ------
    TooFineError
        If there would be too many blocks.
    """
    from tisfm.kernels.fusion.distance_field import VOXELS

    numbers = np.empty(0, np.int64)
    for n, view in enumerate(views):
        numbers = np.union1d(numbers, _blocks_near(view, voxel, truncation))
        if len(numbers) > MOST_BLOCKS:
            expected = len(numbers) * len(views) / (n + 1)
            raise TooFineError(np.sqrt(expected / MOST_BLOCKS))
    distance = np.ones((len(numbers), VOXELS), np.float32)
    weight = np.zeros((len(numbers), VOXELS), np.float32)
    count = np.zeros((len(numbers), VOXELS), np.int32)
    for view in views:
        _integrate(view, voxel, truncation, numbers, distance, weight, count)
    return Field(voxel=voxel, numbers=numbers, distance=distance, views=count)


def _blocks_near(view: PosedDepth, voxel: float, truncation: float) -> Blocks:
    """Return the numbers of the blocks that a view's surface comes near to, ascending."""
    from tisfm.kernels.fusion.distance_field import EDGE, PLACES, blocks_near

    edge = EDGE * voxel
    low, high = _bounds(view, truncation + voxel)
    first = np.floor(low / edge)
    extent = np.floor(high / edge) - first + 1
    if np.abs([first, first + extent]).max() >= _HALF - 1 or extent.prod() >= 2**31:
        raise TooFineError(
            max(
                float(np.cbrt(extent.prod() / 2**31)),
                float(np.abs([first, first + extent]).max() / (_HALF - 1)),
            )
            * 1.01
        )
    nx, ny, nz = extent.astype(int).tolist()
    rays = view.to_world / voxel
    rays[:, 3] -= first * EDGE
    found = []
    for top in range(0, len(view.inverse_depth), _ROWS):
        band = view.inverse_depth[top : top + _ROWS]
        places = np.empty((*band.shape, PLACES), np.int32)
        below = rays.copy()
        below[:, 2] += top * rays[:, 1]
        blocks_near(
            band, places, rays=below.astype(np.float32), extent=(nx, ny, nz), truncation=truncation
        )
        # Most pixels come near to the same blocks as the one to their left.
        new = places >= 0
        new[:, 1:] &= places[:, 1:] != places[:, :-1]
        found.append(np.unique(places[new]))
    flat = np.unique(np.concatenate(found)).astype(np.int64)
    blocks = np.stack([flat // (ny * nz), flat // nz % ny, flat % nz], axis=1)
    return np.sort(numbers_of(blocks + first.astype(np.int64)))


def _bounds(view: PosedDepth, margin: float) -> tuple[Floats, Floats]:
    """Return the least and the greatest coordinates of a view's points, and a margin beyond."""
    row, column = np.nonzero(view.inverse_depth)
    rays = view.to_world
    ahead = rays[:, :3] @ np.stack([column, row, np.ones(len(row))])
    depth = 1 / view.inverse_depth[row, column].astype(float)
    ends = [ahead * (depth + side) + rays[:, 3:] for side in (-margin, margin)]
    # Blocks reach a voxel beside a ray as well.
    low = np.min([end.min(axis=1) for end in ends], axis=0) - margin
    return low, np.max([end.max(axis=1) for end in ends], axis=0) + margin


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
