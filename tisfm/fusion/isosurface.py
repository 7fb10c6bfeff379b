"""The surface where a field of signed distances changes its sign."""

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats
from tisfm.fusion.signed_distance import Blocks, Field, coordinates, numbers_of

# In truncations:
STEEPEST = 1.0  # where the distance changes by more in a cell, there is no surface, but an edge
_LEAST = 1 / 1024  # nearer to a voxel no surface goes, so that it lies on one edge of cells

_SIDE = 16  # blocks of a batch's edge
_BITS = 20  # of a voxel's coordinate
_INSIDE = 3  # in place of an axis: a vertex within a cell

Surface = tuple[Floats, NDArray[np.int32]]


def surface_of(field: Field, agreeing: int) -> Surface:
    """Return the vertices, (V, 3) float64 in the field's unit, and the faces, (F, 3) int32.

    A cell of eight voxels is passed over unless `agreeing` views show the surface near each, and if
    the distance changes by too much in it: there one surface hides another, and nothing was seen
    between them.
    """
    vertices, edges, faces = [np.empty((0, 3))], [np.empty(0, np.int64)], [np.empty((0, 3), int)]
    where = np.flatnonzero(((field.distance < 0) & (field.views >= agreeing)).any(axis=1))
    # A cell belongs to the block of its lowest voxel.
    offsets = np.array(list(np.ndindex(2, 2, 2)))
    near = numbers_of(coordinates(field.numbers[where])[:, None] - offsets)
    owners = np.intersect1d(field.numbers, near)
    total = 0
    for first in range(0, len(owners), _SIDE**3):
        found = _batch(field, owners[first : first + _SIDE**3], agreeing)
        vertices.append(found[0])
        edges.append(found[1])
        faces.append(found[2] + total)
        total += len(found[0])
    # Blocks beside one another find the same vertices on the edges between them.
    _, kept, one = np.unique(np.concatenate(edges), return_index=True, return_inverse=True)
    joined = one.ravel()[np.concatenate(faces)].reshape(-1, 3)
    return np.concatenate(vertices)[kept] * field.voxel, joined.astype(np.int32)


def _batch(
    field: Field, blocks: Blocks, agreeing: int
) -> tuple[Floats, NDArray[np.int64], NDArray[np.intp]]:
    """Return the vertices of some blocks, in voxels, the edges that they lie on, and the faces."""
    from skimage.measure import marching_cubes

    values = np.full((_SIDE**3, 9, 9, 9), np.nan, np.float32)
    values[: len(blocks)] = _with_neighbours(field, blocks, agreeing)
    cells = _cells(values)
    values = np.where(np.isnan(values), np.float32(1), values)
    values = np.copysign(np.maximum(np.abs(values), np.float32(_LEAST)), values)
    volume, mask = _laid_out(values), _laid_out(cells)
    if not mask.any():
        return np.empty((0, 3)), np.empty(0, np.int64), np.empty((0, 3), np.intp)
    # The library judges a cell by its highest corner.
    found, faces, _, _ = marching_cubes(volume, 0.0, mask=np.roll(mask, 1, axis=(0, 1, 2)))
    whole = np.rint(found)
    on_voxel = np.abs(found - whole) < _LEAST / 4
    # A vertex lies between two voxels, so off them along one axis, or else within a cell.
    axis = np.where(on_voxel.sum(axis=1) == 2, np.argmin(on_voxel, axis=1), _INSIDE)
    lower = np.where(on_voxel, whole, np.floor(found)).astype(np.int64)
    tile, local = lower // 9, lower % 9
    origin = 8 * coordinates(blocks[(tile[:, 0] * _SIDE + tile[:, 1]) * _SIDE + tile[:, 2]])
    voxel = local + origin + 2 ** (_BITS - 1)
    edge = (((voxel[:, 0] << _BITS) | voxel[:, 1]) << _BITS) | voxel[:, 2]
    return found.astype(float) - 9 * tile + origin, edge * 4 + axis, faces.astype(np.intp)


def _with_neighbours(field: Field, blocks: Blocks, agreeing: int) -> NDArray[np.float32]:
    """Return the distances of blocks and of the first voxels beyond them, (B, 9, 9, 9).

    They are NaN where too few views show the surface.
    """
    values = np.full((len(blocks), 9, 9, 9), np.nan, np.float32)
    for offset in np.ndindex(2, 2, 2):
        numbers = numbers_of(coordinates(blocks) + offset)
        place = np.searchsorted(field.numbers, numbers)
        place[place == len(field.numbers)] = 0
        there = np.flatnonzero(field.numbers[place] == numbers)
        place = place[there]
        known = np.where(field.views[place] >= agreeing, field.distance[place], np.float32(np.nan))
        (x, y, z), (to_x, to_y, to_z) = (
            [end if beyond else slice(0, 8) for beyond in offset]
            for end in (slice(0, 1), slice(8, 9))
        )
        values[there, to_x, to_y, to_z] = known.reshape(-1, 8, 8, 8)[:, x, y, z]
    return values


def _cells(values: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return in which cells, by their lowest corner, there may be a surface, (B, 9, 9, 9)."""
    corners = [
        values[:, i : i + 8, j : j + 8, k : k + 8] for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    least, most = corners[0].copy(), corners[0].copy()
    for corner in corners[1:]:  # NaN stays NaN
        np.minimum(least, corner, out=least)
        np.maximum(most, corner, out=most)
    cells = np.zeros(values.shape, bool)
    cells[:, :8, :8, :8] = (least < 0) & (most >= 0) & (most - least < STEEPEST)
    return cells


def _laid_out(values: NDArray) -> NDArray:
    """Return the arrays of a batch's blocks side by side, as one volume."""
    grid = values.reshape(_SIDE, _SIDE, _SIDE, 9, 9, 9)
    return np.ascontiguousarray(grid.transpose(0, 3, 1, 4, 2, 5).reshape((9 * _SIDE,) * 3))
