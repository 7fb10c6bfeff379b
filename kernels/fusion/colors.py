"""Colours of points from the views that show them."""

import numpy as np
import taichi as ti

from tisfm.kernels.fusion.lookup import inverse_depth_at, is_inside, nearest
from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel


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
    near: float,
) -> None:
    """Add the colours of a view to the points that the view shows, weighted by 1/Z²."""
    check_array(points, (len(points), 3), "points", aligned=False)
    check_array(inverse_depth, inverse_depth.shape[:2], "inverse_depth", aligned=False)
    check_array(colors, (*inverse_depth.shape, 3), "colors", aligned=False)
    check_array(sums, (len(points), 4), "sums", aligned=False)
    check_array(projection, (3, 4), "projection", aligned=False)
    _add_colors(points, inverse_depth, colors, projection, near, sums)


@Kernel
def _add_colors(
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 3)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    colors: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, 3)
    projection: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    near: ti.f32,
    sums: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (N, 4)
):
    for n in range(points.shape[0]):
        at = ti.Vector([0.0, 0.0, 0.0])
        for k in ti.static(range(3)):
            at[k] = projection[k, 3]
            for i in ti.static(range(3)):
                at[k] += projection[k, i] * points[n, i]
        z = at[2]
        if z > 0:
            u, v = at[0] / z, at[1] / z
            if is_inside(u, v, inverse_depth):
                d = inverse_depth_at(inverse_depth, u, v)
                if d > 0:
                    apart = 1.0 / d - z
                    if ti.max(apart, 0.0 - apart) <= near:
                        column, row = nearest(u, v)
                        weight = 1.0 / (z * z)
                        for k in ti.static(range(3)):
                            sums[n, k] += weight * colors[row, column, k]
                        sums[n, 3] += weight
