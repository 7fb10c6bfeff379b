"""Projection into a depth map, and interpolation between its pixels."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array

# relative step of inverse depth between neighbours that show different surfaces
MAX_SURFACE_STEP = 0.05


def check_map(inverse_depth: np.ndarray, deviation: np.ndarray, name: str = "") -> None:
    """Raise unless the arrays are an inverse depth map and its deviation, (H, W) float32."""
    size = inverse_depth.shape[:2]
    check_array(inverse_depth, size, f"{name}inverse_depth", aligned=False)
    check_array(deviation, size, f"{name}deviation", aligned=False)


@ti.func
def is_inside(x, y, image: ti.template()):
    """Return whether a position lies on a pixel of the image."""
    is_in_columns = x >= -0.5 and x < image.shape[1] - 0.5
    is_in_rows = y >= -0.5 and y < image.shape[0] - 0.5
    return is_in_columns and is_in_rows


@ti.func
def nearest_pixel(x, y):
    """Return column and row of the pixel nearest to a position."""
    return ti.cast(ti.floor(x + 0.5), ti.i32), ti.cast(ti.floor(y + 0.5), ti.i32)


@ti.func
def inverse_depth_at(image: ti.template(), x, y):
    """Return the inverse depth at a position in the image, 0 if the nearest pixel has no depth.

    If the four pixels around show one surface, the value is interpolated bilinearly, since inverse
    depth is linear on a plane. Otherwise it is that of the nearest pixel, so that no depth lies
    between two surfaces.
    """
    column, row = nearest_pixel(x, y)
    value = image[row, column]
    if value > 0:
        left, top = ti.cast(ti.floor(x), ti.i32), ti.cast(ti.floor(y), ti.i32)
        dx, dy = x - left, y - top
        right, below = ti.min(left + 1, image.shape[1] - 1), ti.min(top + 1, image.shape[0] - 1)
        left, top = ti.max(left, 0), ti.max(top, 0)
        a, b = image[top, left], image[top, right]
        c, d = image[below, left], image[below, right]
        min_depth, max_depth = ti.min(a, b, c, d), ti.max(a, b, c, d)
        if min_depth > 0 and max_depth - min_depth < MAX_SURFACE_STEP * max_depth:
            upper = a + dx * (b - a)
            value = upper + dy * (c + dx * (d - c) - upper)
    return value


@ti.func
def project_pixel(projection: ti.template(), k: ti.template(), x, y, d):
    """Return a row of a (3, 4) matrix times (x, y, 1, inverse depth)."""
    return projection[k, 0] * x + projection[k, 1] * y + projection[k, 2] + d * projection[k, 3]


@ti.func
def project_point(projection: ti.template(), k: ti.template(), points: ti.template(), n):
    """Return a row of a (3, 4) matrix times (X, Y, Z, 1) of a point."""
    return (
        projection[k, 0] * points[n, 0]
        + projection[k, 1] * points[n, 1]
        + projection[k, 2] * points[n, 2]
        + projection[k, 3]
    )
