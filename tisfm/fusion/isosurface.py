"""The zero surface of a signed distance field, by marching cubes."""

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats
from tisfm.fusion.signed_distance import Blocks, DistanceField, block_coordinates, block_numbers

# Truncation distances, set by hand: a cell in which the distance changes by more has no surface,
# but a depth discontinuity.
MAX_DISTANCE_CHANGE = 1.0
# Truncation distances: smaller magnitudes are enlarged to this one, so that every vertex lies on
# one edge of a cell, and not on a voxel.
_MIN_DISTANCE = 1 / 1024
_BATCH_SIDE = 16  # blocks along the edge of a batch
_BITS = 20  # bits of a voxel coordinate
_INSIDE_CELL = 3  # instead of an axis (0 to 2): a vertex inside a cell

Surface = tuple[Floats, NDArray[np.int32]]


def extract_surface(field: DistanceField, agreeing: int) -> Surface:
    """Return the vertices, (V, 3) float64 in the field's unit, and the faces, (F, 3) int32.

    A cell of eight voxels is skipped unless `agreeing` views show the surface near each voxel. It
    is also skipped if the distance changes too steeply in it: there one surface occludes another,
    and no view sees between them.
    """
    vertices, edges, faces = [np.empty((0, 3))], [np.empty(0, np.int64)], [np.empty((0, 3), int)]
    indices = np.flatnonzero(((field.distance < 0) & (field.views >= agreeing)).any(axis=1))
    # A cell belongs to the block of its lowest voxel.
    offsets = np.array(list(np.ndindex(2, 2, 2)))
    neighbour_numbers = block_numbers(block_coordinates(field.numbers[indices])[:, None] - offsets)
    owners = np.intersect1d(field.numbers, neighbour_numbers)
    vertex_count = 0
    for start in range(0, len(owners), _BATCH_SIDE**3):
        batch = _extract_batch(field, owners[start : start + _BATCH_SIDE**3], agreeing)
        vertices.append(batch[0])
        edges.append(batch[1])
        faces.append(batch[2] + vertex_count)
        vertex_count += len(batch[0])
    # Adjacent blocks have the same vertices on the edges that they share.
    _, first_indices, numbers = np.unique(
        np.concatenate(edges), return_index=True, return_inverse=True
    )
    merged_faces = numbers.ravel()[np.concatenate(faces)].reshape(-1, 3)
    return np.concatenate(vertices)[first_indices] * field.voxel, merged_faces.astype(np.int32)


def _extract_batch(
    field: DistanceField, blocks: Blocks, agreeing: int
) -> tuple[Floats, NDArray[np.int64], NDArray[np.intp]]:
    """Return the vertices of some blocks, in voxels, the numbers of their edges, and the faces."""
    from skimage.measure import marching_cubes

    values = np.full((_BATCH_SIDE**3, 9, 9, 9), np.nan, np.float32)
    values[: len(blocks)] = _pad_with_neighbours(field, blocks, agreeing)
    cells = _find_surface_cells(values)
    values = np.where(np.isnan(values), np.float32(1), values)
    values = np.copysign(np.maximum(np.abs(values), np.float32(_MIN_DISTANCE)), values)
    volume, mask = _join_blocks(values), _join_blocks(cells)
    if not mask.any():
        return np.empty((0, 3)), np.empty(0, np.int64), np.empty((0, 3), np.intp)
    # The mask of scikit-image is at the highest corner of a cell, ours at the lowest.
    positions, faces, _, _ = marching_cubes(volume, 0.0, mask=np.roll(mask, 1, axis=(0, 1, 2)))
    nearest_voxels = np.rint(positions)
    is_on_voxel = np.abs(positions - nearest_voxels) < _MIN_DISTANCE / 4
    # A vertex between two voxels is off the grid along one axis; other vertices are inside a cell.
    axis = np.where(is_on_voxel.sum(axis=1) == 2, np.argmin(is_on_voxel, axis=1), _INSIDE_CELL)
    lower_voxel = np.where(is_on_voxel, nearest_voxels, np.floor(positions)).astype(np.int64)
    tile, local = lower_voxel // 9, lower_voxel % 9
    origin = 8 * block_coordinates(
        blocks[(tile[:, 0] * _BATCH_SIDE + tile[:, 1]) * _BATCH_SIDE + tile[:, 2]]
    )
    voxel = local + origin + 2 ** (_BITS - 1)
    edge = (((voxel[:, 0] << _BITS) | voxel[:, 1]) << _BITS) | voxel[:, 2]
    return positions.astype(float) - 9 * tile + origin, edge * 4 + axis, faces.astype(np.intp)


def _pad_with_neighbours(
    field: DistanceField, blocks: Blocks, agreeing: int
) -> NDArray[np.float32]:
    """Return the distances in blocks and in the next voxel along each axis, (B, 9, 9, 9).

    They are NaN where too few views show the surface.
    """
    values = np.full((len(blocks), 9, 9, 9), np.nan, np.float32)
    for offset in np.ndindex(2, 2, 2):
        numbers = block_numbers(block_coordinates(blocks) + offset)
        index = np.searchsorted(field.numbers, numbers)
        index[index == len(field.numbers)] = 0
        exists = np.flatnonzero(field.numbers[index] == numbers)
        index = index[exists]
        distances = np.where(
            field.views[index] >= agreeing, field.distance[index], np.float32(np.nan)
        )
        (x, y, z), (to_x, to_y, to_z) = (
            [end if is_beyond else slice(0, 8) for is_beyond in offset]
            for end in (slice(0, 1), slice(8, 9))
        )
        values[exists, to_x, to_y, to_z] = distances.reshape(-1, 8, 8, 8)[:, x, y, z]
    return values


def _find_surface_cells(values: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the cells, by their lowest corner, that may contain a surface, (B, 9, 9, 9) bool."""
    corners = [
        values[:, i : i + 8, j : j + 8, k : k + 8] for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    lowest, highest = corners[0].copy(), corners[0].copy()
    for corner in corners[1:]:  # NaN in a corner makes the result NaN
        np.minimum(lowest, corner, out=lowest)
        np.maximum(highest, corner, out=highest)
    cells = np.zeros(values.shape, bool)
    cells[:, :8, :8, :8] = (lowest < 0) & (highest >= 0) & (highest - lowest < MAX_DISTANCE_CHANGE)
    return cells


def _join_blocks(values: NDArray) -> NDArray:
    """Return the arrays of the blocks of a batch side by side, as one volume."""
    grid = values.reshape(_BATCH_SIDE, _BATCH_SIDE, _BATCH_SIDE, 9, 9, 9)
    return np.ascontiguousarray(grid.transpose(0, 3, 1, 4, 2, 5).reshape((9 * _BATCH_SIDE,) * 3))
