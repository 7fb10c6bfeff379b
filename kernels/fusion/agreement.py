"""Points compared with the depth maps of other views: agreement, visibility, colours."""

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


def compare(
    # inverse_depth, deviation: (H, W) float32, d and σ; 0 where there is no depth. No value may be
    # NaN or infinite.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # other_inverse_depth, other_deviation: (H', W') float32
    other_inverse_depth: np.ndarray,
    other_deviation: np.ndarray,
    other_colors: np.ndarray,  # (H', W', 3) float32
    # (H, W, 5) float32: modified by addition. First Σ 1/σ'² and Σ δ/σ'² over the other views
    # that agree. δ is the inverse depth of the other view, converted to this view, minus d, and σ'
    # is its deviation. Then the number of views that agree, the number that see through, and the
    # number that have any depth where the point projects.
    sums: np.ndarray,
    colors: np.ndarray,  # (H, W, 3) float32: modified: the colours of views that agree are added
    *,
    projection: np.ndarray,  # (3, 4) float32: from this view to the other
    tolerance: float,  # deviations
    max_difference: float,  # share of the inverse depth
) -> None:
    """Compare every point of a view with the depth map of another view where the point projects.

    In the other view the point has inverse depth d' = d / g, with g the ratio of its depths in the
    other view and in this view, and with deviation σ |∂d'/∂d|. Let m be the inverse depth that the
    other view's map has there, and L be `tolerance` combined deviations. The other view agrees with
    the point if |m − d'| ≤ L and |m − d'| ≤ `max_difference` d'. It sees through the point if
    m < d' − L.
    """
    check_map(inverse_depth, deviation)
    check_map(other_inverse_depth, other_deviation, "other_")
    check_array(other_colors, (*other_inverse_depth.shape, 3), "other_colors", aligned=False)
    check_array(sums, (*inverse_depth.shape, 5), "sums", aligned=False)
    check_array(colors, (*inverse_depth.shape, 3), "colors", aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _compare(
        inverse_depth, deviation, other_inverse_depth, other_deviation, other_colors, projection,
        tolerance, max_difference, sums, colors,
    )  # fmt: skip


def mark_pixels_of_points(
    points: np.ndarray,  # (N, 3) float32: in the world's axes
    # (N,) float32: relative deviation of the inverse depth of each point
    relative_deviation: np.ndarray,
    # inverse_depth, deviation: (H, W) float32, 0 where there is no depth. No value may be NaN or
    # infinite.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (H, W) int32: set to 1 where the inverse depth differs from that of a point by at most
    # `tolerance` combined deviations; unchanged elsewhere
    mask: np.ndarray,
    *,
    # (3, 4) float32: (u z, v z, z) of a point is the matrix times (X, Y, Z, 1)
    projection: np.ndarray,
    tolerance: float,  # deviations
) -> None:
    """Mark the pixels of a view that show given points, among the four around each point."""
    check_map(inverse_depth, deviation)
    check_array(points, (len(points), 3), "points", aligned=False)
    check_array(relative_deviation, (len(points),), "relative_deviation", aligned=False)
    check_array(mask, inverse_depth.shape, "mask", dtype=np.int32, aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _mark_pixels_of_points(
        points, relative_deviation, inverse_depth, deviation, projection, tolerance, mask
    )


@Kernel
def _compare(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    other_inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H', W')
    other_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H', W')
    other_colors: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H', W', 3)
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    tolerance: ti.f32,
    max_difference: ti.f32,
    sums: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, 5)
    colors: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, 3)
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
                    other_sigma = other_deviation[row, column]
                    slope = rotated_z / (g * g)  # ∂d'/∂d
                    sigma = slope * deviation[y, x]
                    difference = other_d - d / g
                    limit = tolerance * ti.sqrt(sigma * sigma + other_sigma * other_sigma)
                    sums[y, x, 4] += 1.0
                    if difference < 0.0 - limit:
                        sums[y, x, 3] += 1.0
                    elif ti.max(difference, 0.0 - difference) <= ti.min(
                        limit, max_difference * d / g
                    ):
                        weight = slope / (other_sigma * other_sigma)
                        sums[y, x, 0] += slope * weight
                        sums[y, x, 1] += weight * difference
                        sums[y, x, 2] += 1.0
                        for k in ti.static(range(3)):
                            colors[y, x, k] += other_colors[row, column, k]


@Kernel
def _mark_pixels_of_points(
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 3)
    relative_deviation: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (N,)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    tolerance: ti.f32,
    mask: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
):
    height, width = inverse_depth.shape[0], inverse_depth.shape[1]
    for n in range(points.shape[0]):
        z = project_point(projection, 2, points, n)
        if z > 0:
            u = project_point(projection, 0, points, n) / z
            v = project_point(projection, 1, points, n) / z
            if is_inside(u, v, inverse_depth):
                point_sigma = relative_deviation[n] / z
                left, top = ti.cast(ti.floor(u), ti.i32), ti.cast(ti.floor(v), ti.i32)
                for j, i in ti.static(ti.ndrange(2, 2)):
                    row, column = top + j, left + i
                    if row >= 0 and row < height and column >= 0 and column < width:
                        sigma = deviation[row, column]
                        difference = inverse_depth[row, column] - 1.0 / z
                        limit = tolerance * ti.sqrt(point_sigma * point_sigma + sigma * sigma)
                        # Several threads may write here, but all write 1.
                        if (
                            inverse_depth[row, column] > 0
                            and ti.max(difference, 0.0 - difference) <= limit
                        ):
                            mask[row, column] = 1


def add_colors(
    points: np.ndarray,  # (N, 3) float32: in the world's axes
    # (H, W) float32: 0 where there is no depth. No value may be NaN or infinite.
    inverse_depth: np.ndarray,
    colors: np.ndarray,  # (H, W, 3) float32
    sums: np.ndarray,  # (N, 4) float32: Σ w·colour and Σ w; modified
    *,
    # (3, 4) float32: (u z, v z, z) of a point is the matrix times (X, Y, Z, 1)
    projection: np.ndarray,
    # largest distance of a point from the view's surface, in front or behind, in the unit of depth
    max_distance: float,
) -> None:
    """Add the colours of a view to the points that the view shows, weighted by 1/Z²."""
    check_array(points, (len(points), 3), "points", aligned=False)
    check_array(inverse_depth, inverse_depth.shape[:2], "inverse_depth", aligned=False)
    check_array(colors, (*inverse_depth.shape, 3), "colors", aligned=False)
    check_array(sums, (len(points), 4), "sums", aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _add_colors(points, inverse_depth, colors, projection, max_distance, sums)


@Kernel
def _add_colors(
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 3)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    colors: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, 3)
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    max_distance: ti.f32,
    sums: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 4)
):
    for n in range(points.shape[0]):
        projected = ti.Vector([0.0, 0.0, 0.0])
        for k in ti.static(range(3)):
            projected[k] = projection[k, 3]
            for i in ti.static(range(3)):
                projected[k] += projection[k, i] * points[n, i]
        z = projected[2]
        if z > 0:
            u, v = projected[0] / z, projected[1] / z
            if is_inside(u, v, inverse_depth):
                d = inverse_depth_at(inverse_depth, u, v)
                if d > 0:
                    distance = 1.0 / d - z
                    if ti.max(distance, 0.0 - distance) <= max_distance:
                        column, row = nearest_pixel(u, v)
                        weight = 1.0 / (z * z)
                        for k in ti.static(range(3)):
                            sums[n, k] += weight * colors[row, column, k]
                        sums[n, 3] += weight
