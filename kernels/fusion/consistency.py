"""Depth maps against one another: how far they differ, and which points they see through."""

import numpy as np
import taichi as ti

from tisfm.kernels.fusion.lookup import (
    check_map,
    inverse_depth_at,
    is_inside,
    nearest_pixel,
    project_pixel,
    project_point,
)
from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model import MIN_DEPTH_RATIO


def measure_differences(
    # inverse_depth, deviation: (H, W) float32, d and σ; 0 where there is no depth. No value may be
    # NaN or infinite.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # other_inverse_depth, other_deviation: (H', W') float32
    other_inverse_depth: np.ndarray,
    other_deviation: np.ndarray,
    # (H, W, 2) float32: the size of the difference of inverse depth in the other view, as a share
    # of the inverse depth, and in combined deviations. Pixels that the other view does not show
    # keep their values.
    out: np.ndarray,
    *,
    projection: np.ndarray,  # (3, 4) float32: from this view to the other
) -> None:
    """Measure how far the depth of a view differs from the depth of another view.

    The points, and their inverse depth in the other view, are as in `agreement.compare`.
    """
    check_map(inverse_depth, deviation)
    check_map(other_inverse_depth, other_deviation, "other_")
    check_array(out, (*inverse_depth.shape, 2), "out", aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _measure_differences(
        inverse_depth, deviation, other_inverse_depth, other_deviation, projection, out
    )


def count_views(
    points: np.ndarray,  # (N, 3) float32: in the world's axes
    # (N,) float32: relative deviation of the inverse depth of each point
    relative_deviation: np.ndarray,
    # inverse_depth, deviation: (H, W) float32, 0 where there is no depth. No value may be NaN or
    # infinite.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (N, 2) int32: modified by addition: the number of views whose surface lies at the point, and
    # the number whose surface lies clearly behind it
    counts: np.ndarray,
    *,
    # (3, 4) float32: (u z, v z, z) of a point is the matrix times (X, Y, Z, 1)
    projection: np.ndarray,
    tolerance: float,  # deviations
    min_difference: float,  # share of the inverse depth
) -> None:
    """Count the views that show points, and the views that see through them.

    With L the larger of `tolerance` combined deviations and `min_difference` times the inverse
    depth of the point, a view sees through a point if its inverse depth is smaller by more than L,
    and shows it if the difference is at most L.
    """
    check_map(inverse_depth, deviation)
    check_array(points, (len(points), 3), "points", aligned=False)
    check_array(relative_deviation, (len(points),), "relative_deviation", aligned=False)
    check_array(counts, (len(points), 2), "counts", dtype=np.int32, aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _count_views(
        points, relative_deviation, inverse_depth, deviation, projection, tolerance,
        min_difference, counts,
    )  # fmt: skip


@Kernel
def _measure_differences(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    other_inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H', W')
    other_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H', W')
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    out: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, 2)
):
    for y, x in ti.ndrange(inverse_depth.shape[0], inverse_depth.shape[1]):
        d = inverse_depth[y, x]
        rotated_z = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2]
        g = rotated_z + d * projection[2, 3]
        if d > 0 and g > MIN_DEPTH_RATIO and rotated_z > MIN_DEPTH_RATIO:
            u = project_pixel(projection, 0, x, y, d) / g
            v = project_pixel(projection, 1, x, y, d) / g
            if is_inside(u, v, other_inverse_depth):
                other_d = inverse_depth_at(other_inverse_depth, u, v)
                if other_d > 0:
                    column, row = nearest_pixel(u, v)
                    sigma = rotated_z / (g * g) * deviation[y, x]  # σ ∂d'/∂d
                    other_sigma = other_deviation[row, column]
                    difference = ti.abs(other_d - d / g)
                    out[y, x, 0] = difference * g / d
                    out[y, x, 1] = difference / ti.sqrt(sigma * sigma + other_sigma * other_sigma)


@Kernel
def _count_views(
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 3)
    relative_deviation: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (N,)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    tolerance: ti.f32,
    min_difference: ti.f32,
    counts: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (N, 2)
):
    for n in range(points.shape[0]):
        z = project_point(projection, 2, points, n)
        if z > 0:
            u = project_point(projection, 0, points, n) / z
            v = project_point(projection, 1, points, n) / z
            if is_inside(u, v, inverse_depth):
                column, row = nearest_pixel(u, v)
                d = inverse_depth[row, column]
                if d > 0:
                    point_sigma = relative_deviation[n] / z
                    sigma = deviation[row, column]
                    spread = ti.sqrt(point_sigma * point_sigma + sigma * sigma)
                    limit = ti.max(tolerance * spread, min_difference / z)
                    difference = d - 1.0 / z
                    if difference < 0.0 - limit:
                        counts[n, 1] += 1
                    elif difference <= limit:
                        counts[n, 0] += 1
