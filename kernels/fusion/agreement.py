"""Comparison of a depth map with other views: they agree with a point, or see through it."""

import numpy as np
import taichi as ti

from tisfm.kernels.fusion.lookup import check_map, inverse_depth_at, is_inside, nearest
from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model.constants import NEAREST


def compare(
    # inverse_depth, deviation: (H, W) float32, d and σ; 0 where there is no depth. No value may be
    # NaN or infinite.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # other_inverse_depth, other_deviation: (H', W') float32
    other_inverse_depth: np.ndarray,
    other_deviation: np.ndarray,
    other_colors: np.ndarray,  # (H', W', 3) float32
    # (H, W, 4) float32: modified by addition. Over the other views that agree: Σ 1/σ'² and Σ δ/σ'²,
    # with δ the difference of their inverse depth from d, as seen from this view, and σ' its
    # deviation. Then the number of views that agree, and the number that see through.
    sums: np.ndarray,
    colors: np.ndarray,  # (H, W, 3) float32: modified: the colours of views that agree are added
    *,
    projection: np.ndarray,  # (3, 4) float32: from this view to the other
    tolerance: float,  # deviations
) -> None:
    """Compare every point of a view with the depth map of another view at the same position.

    In the other view the point has inverse depth d' = d / g, with deviation σ |∂d'/∂d|. The other
    view agrees with the point if its own inverse depth there differs by at most `tolerance`
    combined deviations. It sees through the point if its own depth there is larger than that.
    """
    check_map(inverse_depth, deviation)
    check_map(other_inverse_depth, other_deviation, "other_")
    check_array(other_colors, (*other_inverse_depth.shape, 3), "other_colors", aligned=False)
    check_array(sums, (*inverse_depth.shape, 4), "sums", aligned=False)
    check_array(colors, (*inverse_depth.shape, 3), "colors", aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _compare(
        inverse_depth,
        deviation,
        other_inverse_depth,
        other_deviation,
        other_colors,
        projection,
        tolerance,
        sums,
        colors,
    )


def mark_shown(
    points: np.ndarray,  # (N, 3) float32: in the world's axes
    # (N,) float32: relative deviation of the inverse depth of each point
    relative_deviation: np.ndarray,
    # inverse_depth, deviation: (H, W) float32, 0 where there is no depth. No value may be NaN or
    # infinite.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (H, W) int32: set to 1 where the inverse depth differs from that of a point by at most
    # `tolerance` combined deviations; unchanged elsewhere
    shown: np.ndarray,
    *,
    # (3, 4) float32: (u z, v z, z) of a point is the matrix times (X, Y, Z, 1)
    projection: np.ndarray,
    tolerance: float,  # deviations
) -> None:
    """Mark the pixels of a view that show given points, among the four around each point."""
    check_map(inverse_depth, deviation)
    check_array(points, (len(points), 3), "points", aligned=False)
    check_array(relative_deviation, (len(points),), "relative_deviation", aligned=False)
    check_array(shown, inverse_depth.shape, "shown", dtype=np.int32, aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _mark_shown(points, relative_deviation, inverse_depth, deviation, projection, tolerance, shown)


@Kernel
def _compare(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    other_inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H', W')
    other_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H', W')
    other_colors: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H', W', 3)
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    tolerance: ti.f32,
    sums: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, 4)
    colors: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, 3)
):
    for y, x in ti.ndrange(inverse_depth.shape[0], inverse_depth.shape[1]):
        d = inverse_depth[y, x]
        turned = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2]
        g = turned + d * projection[2, 3]
        if d > 0 and g > NEAREST and turned > NEAREST:
            u = _coordinate(projection, 0, x, y, d) / g
            v = _coordinate(projection, 1, x, y, d) / g
            if is_inside(u, v, other_inverse_depth):
                seen = inverse_depth_at(other_inverse_depth, u, v)
                if seen > 0:
                    column, row = nearest(u, v)
                    theirs = other_deviation[row, column]
                    slope = turned / (g * g)  # ∂d'/∂d
                    mine = slope * deviation[y, x]
                    apart = seen - d / g
                    limit = tolerance * ti.sqrt(mine * mine + theirs * theirs)
                    if apart < 0.0 - limit:
                        sums[y, x, 3] += 1.0
                    elif apart <= limit:
                        weight = slope / (theirs * theirs)
                        sums[y, x, 0] += slope * weight
                        sums[y, x, 1] += weight * apart
                        sums[y, x, 2] += 1.0
                        for k in ti.static(range(3)):
                            colors[y, x, k] += other_colors[row, column, k]


@ti.func
def _coordinate(projection: ti.template(), k: ti.template(), x, y, d):
    return projection[k, 0] * x + projection[k, 1] * y + projection[k, 2] + d * projection[k, 3]


@Kernel
def _mark_shown(
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 3)
    relative_deviation: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (N,)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    tolerance: ti.f32,
    shown: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
):
    height, width = inverse_depth.shape[0], inverse_depth.shape[1]
    for n in range(points.shape[0]):
        z = _of_point(projection, 2, points, n)
        if z > 0:
            u = _of_point(projection, 0, points, n) / z
            v = _of_point(projection, 1, points, n) / z
            if is_inside(u, v, inverse_depth):
                mine = relative_deviation[n] / z
                left, top = ti.cast(ti.floor(u), ti.i32), ti.cast(ti.floor(v), ti.i32)
                for j, i in ti.static(ti.ndrange(2, 2)):
                    row, column = top + j, left + i
                    if row >= 0 and row < height and column >= 0 and column < width:
                        theirs = deviation[row, column]
                        apart = inverse_depth[row, column] - 1.0 / z
                        limit = tolerance * ti.sqrt(mine * mine + theirs * theirs)
                        # Several threads may write here, but all write 1.
                        if inverse_depth[row, column] > 0 and ti.max(apart, 0.0 - apart) <= limit:
                            shown[row, column] = 1


@ti.func
def _of_point(projection: ti.template(), k: ti.template(), points: ti.template(), n):
    return (
        projection[k, 0] * points[n, 0]
        + projection[k, 1] * points[n, 1]
        + projection[k, 2] * points[n, 2]
        + projection[k, 3]
    )
