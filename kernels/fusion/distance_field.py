"""A truncated signed distance field, in blocks of 8³ voxels near the surface.

References
----------
Curless and Levoy, "A volumetric method for building complex models from range images", SIGGRAPH
1996, doi 10.1145/237170.237269.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.fusion.lookup import (
    MAX_SURFACE_STEP,
    check_map,
    inverse_depth_at,
    is_inside,
    nearest_pixel,
)
from tisfm.kernels.layout.lanes import MAX_INDEX, check_array
from tisfm.kernels.layout.launch import Kernel

BLOCK_EDGE = 8  # voxels along the edge of a block
VOXELS = BLOCK_EDGE**3
CORNERS = 8  # corners of the cube around each sample of a ray
# truncations: depth is interpolated only for voxels within this distance of the pixel's depth
MAX_INTERPOLATION_DISTANCE = 2.0
MIN_SIMILAR_NEIGHBOURS = 3  # of eight: with fewer similar neighbours, a pixel's depth is wrong
# deviations: pixels with a smaller difference are similar, even if it exceeds `MAX_SURFACE_STEP`
MAX_SIMILAR_DEVIATIONS = 3.0


def find_blocks(
    # inverse_depth, deviation: (H, W) float32, d and σ; 0 where there is no depth. No value may be
    # NaN or infinite. Pixels with fewer than three similar neighbours, of eight, are skipped.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (rows, ⌈W / stride⌉, samples, 8) int32: for each sampled row from `top` on, column and sample:
    # the numbers of the blocks at the corners around the sample, (bx·n_y + by)·n_z + bz. A
    # number that a previous corner has, and a block outside, are −1
    out: np.ndarray,
    *,
    # top, stride: the first sampled row, and the step of rows and columns
    top: int,
    stride: int,
    # (3, 4) float32: the point of pixel (x, y) at depth Z has the coordinates columns 0 to 2 times
    # (x, y, 1) Z, plus column 3, in voxels from the lowest corner of the grid
    rays: np.ndarray,
    # (n_x, n_y, n_z): size of the grid, in blocks; blocks outside are left out
    extent: tuple[int, int, int],
    # distance in front of and behind the surface, along the view's axis, in the unit of depth
    truncation: float,
) -> None:
    """Find the blocks near the surface of a depth map: within the truncation along each ray.

    Each ray is sampled at equal distances. Blocks within one voxel of a sample are included too, so
    that every cell that the surface crosses has its eight corners.

    Raises ValueError if the block numbers of the grid do not fit into 32 bits.
    """
    check_map(inverse_depth, deviation)
    height, width = inverse_depth.shape
    if stride < 1:
        raise ValueError(f"stride is {stride}: expected at least 1")
    if not 0 <= top <= top + (len(out) - 1) * stride < height:
        raise ValueError(f"top is {top}: {len(out)} rows from there are more than {height} have")
    size = (len(out), -(-width // stride), out.shape[2], CORNERS)
    check_array(out, size, "out", dtype=np.int32, aligned=False)
    if out.shape[2] < 2:
        raise ValueError(f"out has {out.shape[2]} samples for a ray: expected at least 2")
    check_array(rays, (3, 4), "rays", aligned=False)
    if min(extent) < 1 or np.prod(np.asarray(extent, float)) > MAX_INDEX:
        raise ValueError(f"extent is {extent}: expected 1 to {MAX_INDEX} blocks")
    _find_blocks(inverse_depth, deviation, top, stride, rays, *extent, truncation, out)


def integrate(
    # inverse_depth, deviation: (H, W) float32, d and σ; 0 where there is no depth. No value may be
    # NaN or infinite.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (B, 3) float32: (u z, v z, z) of the first voxel of each block, in the view's pixels
    corners: np.ndarray,
    index: np.ndarray,  # (B,) int32: number of each block in the field; all are different
    # distance, weight: (N, 512) float32, mean distance in truncations, in [−1, 1], and its weight Σ
    # spread² / (σ_Z² + spread²), with σ_Z = σ / d²; modified
    distance: np.ndarray,
    weight: np.ndarray,
    # (N, 512) int32: number of views that show the surface within the truncation; modified
    views: np.ndarray,
    *,
    steps: np.ndarray,  # (3, 3) float32: change of (u z, v z, z) for one voxel along each axis
    # truncation, spread: in the unit of depth
    truncation: float,
    spread: float,
) -> None:
    """Add a depth map to the field, a mean of signed distances weighted by their precision.

    The distance of a voxel to the surface is measured along the view's axis, positive in front of
    the surface, and clipped at the truncation. Voxels farther behind the surface are hidden, and
    are not changed.
    """
    check_map(inverse_depth, deviation)
    check_array(corners, (len(corners), 3), "corners", aligned=False)
    check_array(index, (len(corners),), "index", dtype=np.int32, aligned=False)
    check_array(distance, (len(distance), VOXELS), "distance", aligned=False)
    check_array(weight, distance.shape, "weight", aligned=False)
    check_array(views, distance.shape, "views", dtype=np.int32, aligned=False)
    check_array(steps, (3, 3), "steps", aligned=False)
    if len(index) and not 0 <= index.min() <= index.max() < len(distance):
        raise ValueError(
            f"index is {index.min()} to {index.max()}: expected 0 to {len(distance) - 1}"
        )
    _integrate(
        inverse_depth, deviation, corners, index, steps, truncation, spread, distance, weight, views
    )


@Kernel
def _find_blocks(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    top: ti.i32,
    stride: ti.i32,
    rays: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    blocks_x: ti.i32,
    blocks_y: ti.i32,
    blocks_z: ti.i32,
    truncation: ti.f32,
    out: ti.types.ndarray(dtype=ti.i32, ndim=4),  # (rows, ⌈W / stride⌉, samples, 8)
):
    for row, column in ti.ndrange(out.shape[0], out.shape[1]):
        y, x = top + row * stride, column * stride
        d = inverse_depth[y, x]
        if _similar_neighbours(inverse_depth, deviation, y, x) < MIN_SIMILAR_NEIGHBOURS:
            d = 0.0
        for sample in range(out.shape[2]):
            depth = (2.0 * sample / (out.shape[2] - 1) - 1.0) * truncation
            if d > 0:
                depth += 1.0 / d
            px = _along_ray(rays, 0, x, y, depth)
            py = _along_ray(rays, 1, x, y, depth)
            pz = _along_ray(rays, 2, x, y, depth)
            low_x, high_x = _block(px - 1.0), _block(px + 1.0)
            low_y, high_y = _block(py - 1.0), _block(py + 1.0)
            low_z, high_z = _block(pz - 1.0), _block(pz + 1.0)
            for i, j, k in ti.static(ti.ndrange(2, 2, 2)):
                bx = high_x if ti.static(i == 1) else low_x
                by = high_y if ti.static(j == 1) else low_y
                bz = high_z if ti.static(k == 1) else low_z
                is_repeated = (
                    (ti.static(i == 1) and low_x == high_x)
                    or (ti.static(j == 1) and low_y == high_y)
                    or (ti.static(k == 1) and low_z == high_z)
                )
                is_in_range = bx >= 0 and bx < blocks_x and by >= 0 and by < blocks_y
                is_in_range = is_in_range and bz >= 0 and bz < blocks_z
                number = -1
                if d > 0 and depth > 0 and is_in_range and not is_repeated:
                    number = (bx * blocks_y + by) * blocks_z + bz
                out[row, column, sample, i * 4 + j * 2 + k] = number


@ti.func
def _similar_neighbours(inverse_depth: ti.template(), deviation: ti.template(), y, x):
    """Return the number of neighbours, of eight, that show the same surface as a pixel."""
    d = inverse_depth[y, x]
    max_difference = ti.max(MAX_SURFACE_STEP * d, MAX_SIMILAR_DEVIATIONS * deviation[y, x])
    count = 0
    for j, i in ti.static(ti.ndrange((-1, 2), (-1, 2))):
        row, column = y + j, x + i
        is_in_range = row >= 0 and row < inverse_depth.shape[0]
        if is_in_range and column >= 0 and column < inverse_depth.shape[1]:
            difference = inverse_depth[row, column] - d
            if ti.max(difference, 0.0 - difference) < max_difference:
                count += 1
    return count - 1  # without the pixel itself


@ti.func
def _along_ray(rays: ti.template(), k: ti.template(), x, y, depth):
    return (rays[k, 0] * x + rays[k, 1] * y + rays[k, 2]) * depth + rays[k, 3]


@ti.func
def _block(position):
    return ti.cast(ti.floor(position / BLOCK_EDGE), ti.i32)


@Kernel
def _integrate(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    corners: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (B, 3)
    index: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (B,)
    steps: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 3)
    truncation: ti.f32,
    spread: ti.f32,
    distance: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 512)
    weight: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 512)
    views: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (N, 512)
):
    for task in range(corners.shape[0] * VOXELS):
        # Shifts, because integer divisions would take as long as everything else here.
        b, voxel = task >> 9, task & (VOXELS - 1)
        i, j, k = voxel >> 6, (voxel >> 3) & (BLOCK_EDGE - 1), voxel & (BLOCK_EDGE - 1)
        z = corners[b, 2] + i * steps[0, 2] + j * steps[1, 2] + k * steps[2, 2]
        if z > 0:
            u = (corners[b, 0] + i * steps[0, 0] + j * steps[1, 0] + k * steps[2, 0]) / z
            v = (corners[b, 1] + i * steps[0, 1] + j * steps[1, 1] + k * steps[2, 1]) / z
            if is_inside(u, v, inverse_depth):
                column, row = nearest_pixel(u, v)
                d = inverse_depth[row, column]
                if d > 0 and d * (z - MAX_INTERPOLATION_DISTANCE * truncation) <= 1.0:
                    if d * (z + MAX_INTERPOLATION_DISTANCE * truncation) >= 1.0:
                        d = inverse_depth_at(inverse_depth, u, v)
                    signed_distance = (1.0 / d - z) / truncation
                    if signed_distance >= -1.0:
                        depth_deviation = deviation[row, column] / (d * d)
                        new_weight = (
                            spread * spread / (depth_deviation * depth_deviation + spread * spread)
                        )
                        n = index[b]
                        total_weight = weight[n, voxel] + new_weight
                        change = ti.min(signed_distance, 1.0) - distance[n, voxel]
                        distance[n, voxel] += new_weight / total_weight * change
                        weight[n, voxel] = total_weight
                        if signed_distance <= 1.0:
                            views[n, voxel] += 1
