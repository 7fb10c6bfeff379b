"""Inverse depth maps of one view, rendered in another view.

Neighbour pixels of one surface span a surface: the square between four of them is drawn as two
triangles, also where the other view stretches it, and each pixel is drawn at the pixel that it
rounds to. The nearest surface wins. The exact value is then looked up: the pixel is projected back
to the first view along its ray, and the inverse depth there is projected into the other view again.

Between two surfaces the first view shows a jump. Where the other view stretches the jump, it looks
behind the nearer surface. The farther surface is continued there, at its own inverse depth, with a
large deviation.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

# All constants of this module were set by hand.
# largest relative difference of inverse depth between neighbour pixels of one surface
MAX_SURFACE_DIFFERENCE = 0.05
# px: a square that the other view stretches to more rows or columns is not drawn
MAX_STRETCH = 256.0
BORDER_TOLERANCE = 1e-3  # px: a pixel so near to a triangle belongs to it
MIN_AREA = 1e-6  # px²: twice the area of the smallest triangle that is drawn
MIN_SURFACE_SHARE = 1e-3  # least share of the weights of the four pixels around, of the surface
MIN_Z = 1e-12  # bound of Z, which is a divisor


def render_depth(
    inverse_depth: np.ndarray,  # (H, W) float32: 1/Z; 0 where unknown
    deviation: np.ndarray,  # (H, W) float32: its standard deviation; finite
    motion: np.ndarray,  # (3, 4) array: R and t from the first view's axes to the other's
    # out, out_deviation: (H, W) float32, inverse depth and deviation in the other view; 0 where it
    # shows no surface of the first view
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    center: tuple[float, float],  # principal point of both views, px
    focal: float,  # focal length of both views, px
    # deviation of continued surfaces, as a share of the inverse depth; 0 to continue none
    continued_deviation: float = 0.0,
) -> None:
    """Render the inverse depth of a view, and its deviation, in another view.

    Raises TypeError, ValueError if an array is not of these types and sizes.

    Notes
    -----
    Values must be finite: with fast math, comparisons with NaN are unreliable.
    """
    shape = inverse_depth.shape
    for name, array in (
        ("inverse_depth", inverse_depth),
        ("deviation", deviation),
        ("out", out),
        ("out_deviation", out_deviation),
    ):
        check_array(array, shape, name, aligned=False)
    if np.shape(motion) != (3, 4):
        raise ValueError(f"motion is {np.shape(motion)}: expected (3, 4)")
    motion = np.ascontiguousarray(motion, np.float32)
    points = np.empty((3, *shape), np.float32)
    nearest, continued = (np.zeros(shape, np.float32) for _ in range(2))
    view = motion, float(center[0]), float(center[1]), float(focal)
    _project(inverse_depth, *view, points, nearest)
    _draw_squares(inverse_depth, points, int(continued_deviation > 0), nearest, continued)
    _look_up(
        inverse_depth, deviation, nearest, continued, *view, float(continued_deviation), out,
        out_deviation,
    )  # fmt: skip


@Kernel
def _project(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    # x and y, px, and inverse depth in the other view; the inverse depth is 0 without a point there
    points: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (3, H, W)
    nearest: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    """Project each pixel, and keep the largest inverse depth that rounds to each other pixel."""
    for y, x in ti.ndrange(inverse_depth.shape[0], inverse_depth.shape[1]):
        depth = inverse_depth[y, x]
        position = ti.Vector([0.0, 0.0, 0.0])
        if depth > 0.0:
            ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
            point = _move(motion, ray, depth)
            if point[2] > MIN_Z:
                position[0] = point[0] / point[2] * focal + cx
                position[1] = point[1] / point[2] * focal + cy
                position[2] = depth / point[2]
                if _is_inside(position[0], position[1], inverse_depth.shape):
                    column = ti.cast(ti.floor(position[0] + 0.5), ti.i32)
                    row = ti.cast(ti.floor(position[1] + 0.5), ti.i32)
                    ti.atomic_max(nearest[row, column], position[2])
        for k in ti.static(range(3)):
            points[k, y, x] = position[k]


@ti.func
def _is_inside(x, y, shape: ti.template()):
    """Return whether a position rounds to a pixel."""
    return x > -0.5 and y > -0.5 and x < shape[1] - 0.5 and y < shape[0] - 0.5


@Kernel
def _draw_squares(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    points: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (3, H, W)
    with_continued: ti.i32,
    nearest: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    continued: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    """Draw the squares between pixels: one surface into `nearest`, jumps into `continued`."""
    height, width = inverse_depth.shape[0], inverse_depth.shape[1]
    for y, x in ti.ndrange(height - 1, width - 1):
        is_known = inverse_depth[y, x] > 0.0 and inverse_depth[y, x + 1] > 0.0
        is_known = is_known and inverse_depth[y + 1, x] > 0.0 and inverse_depth[y + 1, x + 1] > 0.0
        a, b = _point(points, y, x), _point(points, y, x + 1)
        c, d = _point(points, y + 1, x), _point(points, y + 1, x + 1)
        if is_known and ti.min(a[2], b[2], c[2], d[2]) > 0.0:
            is_surface = _is_surface(inverse_depth, y, x, 0, 1)
            is_surface = is_surface and _is_surface(inverse_depth, y + 1, x, 0, 1)
            is_surface = is_surface and _is_surface(inverse_depth, y, x, 1, 0)
            is_surface = is_surface and _is_surface(inverse_depth, y, x + 1, 1, 0)
            if is_surface:
                _draw_triangle(nearest, a, b, d)
                _draw_triangle(nearest, a, d, c)
            elif with_continued == 1:
                # the farthest of the four pixels
                depth = ti.min(a[2], b[2], c[2], d[2])
                a[2], b[2], c[2], d[2] = depth, depth, depth, depth
                _draw_triangle(continued, a, b, d)
                _draw_triangle(continued, a, d, c)


@ti.func
def _point(points: ti.template(), y, x):
    return ti.Vector([points[0, y, x], points[1, y, x], points[2, y, x]])


@ti.func
def _is_surface(inverse_depth: ti.template(), y, x, down: ti.template(), right: ti.template()):
    """Return whether a pixel and its neighbour below or to its right show one surface."""
    first, second = inverse_depth[y, x], inverse_depth[y + down, x + right]
    return ti.abs(second - first) < MAX_SURFACE_DIFFERENCE * ti.max(first, second)


@ti.func
def _draw_triangle(image: ti.template(), a, b, c):
    """Keep the largest inverse depth of a triangle at the pixels inside; corners are (x, y, d).

    The inverse depth of a plane is linear in the position.
    """
    ab, ac = b - a, c - a
    area = ab[0] * ac[1] - ab[1] * ac[0]
    top, bottom = ti.min(a[1], b[1], c[1]), ti.max(a[1], b[1], c[1])
    left, right = ti.min(a[0], b[0], c[0]), ti.max(a[0], b[0], c[0])
    is_drawn = ti.abs(area) > MIN_AREA
    is_drawn = is_drawn and right - left < MAX_STRETCH and bottom - top < MAX_STRETCH
    is_drawn = is_drawn and right > -1.0 and left < image.shape[1]
    if is_drawn and bottom > -1.0 and top < image.shape[0]:
        nearest, farthest = ti.max(a[2], b[2], c[2]), ti.min(a[2], b[2], c[2])
        slope_x = (ab[2] * ac[1] - ac[2] * ab[1]) / area
        slope_y = (ac[2] * ab[0] - ab[2] * ac[0]) / area
        first = ti.max(ti.cast(ti.ceil(top - BORDER_TOLERANCE), ti.i32), 0)
        last = ti.min(ti.cast(ti.floor(bottom + BORDER_TOLERANCE), ti.i32), image.shape[0] - 1)
        for row in range(first, last + 1):
            y = ti.min(ti.max(ti.cast(row, ti.f32), top), bottom)
            span = ti.Vector([right, left])
            span = _widen(span, y, a, b)
            span = _widen(span, y, b, c)
            span = _widen(span, y, c, a)
            start = ti.max(ti.cast(ti.ceil(span[0] - BORDER_TOLERANCE), ti.i32), 0)
            end = ti.min(ti.cast(ti.floor(span[1] + BORDER_TOLERANCE), ti.i32), image.shape[1] - 1)
            for column in range(start, end + 1):
                value = a[2] + slope_x * (column - a[0]) + slope_y * (row - a[1])
                # Rounding makes the slopes of a thin triangle unreliable.
                value = ti.max(ti.min(value, nearest), farthest)
                ti.atomic_max(image[row, column], value)


@ti.func
def _widen(span, y, a, b):
    """Return the span of x, widened to where the edge from a to b crosses a row, if it does."""
    low, high = ti.min(a[1], b[1]), ti.max(a[1], b[1])
    if y >= low and y <= high:
        share = 0.0
        if high > low:
            share = (y - a[1]) / (b[1] - a[1])
        x = a[0] + share * (b[0] - a[0])
        other = x
        if high == low:
            other = b[0]
        span = ti.Vector([ti.min(span[0], x, other), ti.max(span[1], x, other)])
    return span


@Kernel
def _look_up(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    nearest: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    continued: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    continued_deviation: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(inverse_depth.shape[0], inverse_depth.shape[1]):
        ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
        result = _look_along_ray(
            inverse_depth, deviation, motion, cx, cy, focal, ray, nearest[y, x]
        )
        if result[0] <= 0.0:
            result = ti.Vector([continued[y, x], continued_deviation * continued[y, x]])
        out[y, x] = result[0]
        out_deviation[y, x] = result[1]


@ti.func
def _look_along_ray(
    inverse_depth: ti.template(), deviation: ti.template(), motion: ti.template(), cx, cy, focal,
    ray, value,
):  # fmt: skip
    """Return inverse depth and deviation along a ray, near inverse depth `value`; 0 if none."""
    result = ti.Vector([0.0, 0.0])
    source = _move_back(motion, ray, value)
    if value > 0.0 and source[2] > MIN_Z:
        column = source[0] / source[2] * focal + cx
        row = source[1] / source[2] * focal + cy
        sums = _sum_surface(inverse_depth, deviation, row, column, value / source[2])
        if sums[0] > MIN_SURFACE_SHARE:
            depth = sums[1] / sums[0]
            source_ray = ti.Vector([(column - cx) / focal, (row - cy) / focal, 1.0])
            point = _move(motion, source_ray, depth)
            if point[2] > MIN_Z:
                rotated_z = point[2] - depth * motion[2, 3]
                scale_change = ti.abs(rotated_z / (point[2] * point[2]))
                result = ti.Vector([depth / point[2], sums[2] / sums[0] * scale_change])
    return result


@ti.func
def _sum_surface(
    inverse_depth: ti.template(), deviation: ti.template(), row, column, surface_depth
):
    """Return Σw, Σw·d and Σw·σ of the pixels that show the surface, among the four around."""
    sums = ti.Vector([0.0, 0.0, 0.0])
    left, top = ti.cast(ti.floor(column), ti.i32), ti.cast(ti.floor(row), ti.i32)
    for j, i in ti.static(ti.ndrange(2, 2)):
        down, right = top + j, left + i
        is_inside = right >= 0 and right < inverse_depth.shape[1]
        if is_inside and down >= 0 and down < inverse_depth.shape[0]:
            depth = inverse_depth[down, right]
            difference = ti.abs(depth - surface_depth)
            if depth > 0.0 and difference < MAX_SURFACE_DIFFERENCE * surface_depth:
                weight = (1.0 - ti.abs(column - right)) * (1.0 - ti.abs(row - down))
                sums = sums + weight * ti.Vector([1.0, depth, deviation[down, right]])
    return sums


@ti.func
def _move(motion: ti.template(), ray, depth):
    """Return R x̂ + d t: the moved point, multiplied by its inverse depth d before the motion."""
    point = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        rotated = motion[k, 0] * ray[0] + motion[k, 1] * ray[1] + motion[k, 2] * ray[2]
        point[k] = rotated + depth * motion[k, 3]
    return point


@ti.func
def _move_back(motion: ti.template(), ray, depth):
    """Return Rᵀ(x̂ − d t): `_move` for the inverse motion."""
    shifted = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        shifted[k] = ray[k] - depth * motion[k, 3]
    point = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        point[k] = motion[0, k] * shifted[0] + motion[1, k] * shifted[1] + motion[2, k] * shifted[2]
    return point
