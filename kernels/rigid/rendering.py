"""Inverse depth of one view as another view sees it.

Each pixel is projected into the other view and splatted to the four pixels around; the nearest
surface wins. This determines the surface of a pixel, on the grid of pixels. The exact value is then
looked up: the pixel is projected back to the first view along its ray, and the inverse depth there
is projected into the other view again. If more than half of the weight there belongs to another
surface, the pixel lies beside an edge. Then the nearest surface among the points that round to the
pixel itself is looked up instead.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

# All of these were set by hand.
ALIKE = 0.05  # relative difference of inverse depth between pixels of one surface, at most
LOOKS = 2  # projections back and forth of each pixel
MOST = 0.5  # least share of the weights of the four pixels for the nearest surface to be used
LEAST = 1e-3  # the same share for the surface nearest to the pixel's centre
NEAREST = 1e-12  # least Z, which is a divisor


def rendered(
    inverse_depth: np.ndarray,  # (H, W) float32: 1/Z; 0 where unknown
    deviation: np.ndarray,  # (H, W) float32: its standard deviation; finite
    motion: np.ndarray,  # (3, 4) array: R and t from the first view's axes to the other's
    # out, out_deviation: (H, W) float32, inverse depth and deviation in the other view; 0 where no
    # pixel arrives
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    center: tuple[float, float],  # principal point of both views, px
    focal: float,  # focal length of both views, px
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
    nearest, central = (np.zeros(shape, np.float32) for _ in range(2))
    view = motion, float(center[0]), float(center[1]), float(focal)
    _nearest_surfaces(inverse_depth, *view, nearest, central)
    _looked_up(inverse_depth, deviation, nearest, central, *view, out, out_deviation)


@Kernel
def _nearest_surfaces(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    nearest: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    central: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    """Keep the largest inverse depth that arrives at each pixel, which is independent of order."""
    height, width = inverse_depth.shape[0], inverse_depth.shape[1]
    for y, x in ti.ndrange(height, width):
        depth = inverse_depth[y, x]
        if depth > 0.0:
            ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
            place = _moved(motion, ray, depth)
            if place[2] > NEAREST:
                target_x = place[0] / place[2] * focal + cx
                target_y = place[1] / place[2] * focal + cy
                across = target_x > -1.0 and target_x < width
                if across and target_y > -1.0 and target_y < height:
                    there = depth / place[2]
                    column = ti.cast(ti.floor(target_x), ti.i32)
                    row = ti.cast(ti.floor(target_y), ti.i32)
                    for j, i in ti.static(ti.ndrange(2, 2)):
                        _keep(nearest, row + j, column + i, there)
                    column = ti.cast(ti.floor(target_x + 0.5), ti.i32)
                    row = ti.cast(ti.floor(target_y + 0.5), ti.i32)
                    _keep(central, row, column, there)


@ti.func
def _keep(largest: ti.template(), row, column, value):
    if row >= 0 and row < largest.shape[0] and column >= 0 and column < largest.shape[1]:
        ti.atomic_max(largest[row, column], value)


@Kernel
def _looked_up(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    nearest: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    central: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(inverse_depth.shape[0], inverse_depth.shape[1]):
        ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
        found = _look(inverse_depth, deviation, motion, cx, cy, focal, ray, nearest[y, x], MOST)
        if found[0] <= 0.0:
            found = _look(
                inverse_depth, deviation, motion, cx, cy, focal, ray, central[y, x], LEAST
            )
        out[y, x] = found[0]
        out_deviation[y, x] = found[1]


@ti.func
def _look(
    inverse_depth: ti.template(),
    deviation: ti.template(),
    motion: ti.template(),
    cx,
    cy,
    focal,
    ray,
    value,
    least,
):
    """Return inverse depth and deviation along a ray, near inverse depth `value`; 0 if none."""
    spread = 0.0
    for _ in ti.static(range(LOOKS)):
        source = _taken_back(motion, ray, value)
        found, found_spread = 0.0, 0.0
        if value > 0.0 and source[2] > NEAREST:
            column = source[0] / source[2] * focal + cx
            row = source[1] / source[2] * focal + cy
            sums = _mean(inverse_depth, deviation, row, column, value / source[2])
            if sums[0] > least:
                depth = sums[1] / sums[0]
                there = ti.Vector([(column - cx) / focal, (row - cy) / focal, 1.0])
                place = _moved(motion, there, depth)
                if place[2] > NEAREST:
                    found = depth / place[2]
                    turned = place[2] - depth * motion[2, 3]
                    stretch = turned / (place[2] * place[2])
                    found_spread = sums[2] / sums[0] * ti.max(stretch, 0.0 - stretch)
        value, spread = found, found_spread
    return ti.Vector([value, spread])


@ti.func
def _mean(inverse_depth: ti.template(), deviation: ti.template(), row, column, expected):
    """Return Σw, Σw·d and Σw·σ over those of the four pixels around that show the surface."""
    sums = ti.Vector([0.0, 0.0, 0.0])
    left, top = ti.cast(ti.floor(column), ti.i32), ti.cast(ti.floor(row), ti.i32)
    for j, i in ti.static(ti.ndrange(2, 2)):
        down, right = top + j, left + i
        within = right >= 0 and right < inverse_depth.shape[1]
        if within and down >= 0 and down < inverse_depth.shape[0]:
            depth = inverse_depth[down, right]
            apart = ti.max(depth - expected, expected - depth)
            if depth > 0.0 and apart < ALIKE * expected:
                dx, dy = column - right, row - down
                weight = (1.0 - ti.max(dx, 0.0 - dx)) * (1.0 - ti.max(dy, 0.0 - dy))
                sums = sums + weight * ti.Vector([1.0, depth, deviation[down, right]])
    return sums


@ti.func
def _moved(motion: ti.template(), ray, depth):
    """Return R x̂ + d t: the moved point, multiplied by its inverse depth d before the motion."""
    place = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        turned = motion[k, 0] * ray[0] + motion[k, 1] * ray[1] + motion[k, 2] * ray[2]
        place[k] = turned + depth * motion[k, 3]
    return place


@ti.func
def _taken_back(motion: ti.template(), ray, depth):
    """Return Rᵀ(x̂ − d t): `_moved` for the inverse motion."""
    away = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        away[k] = ray[k] - depth * motion[k, 3]
    place = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        place[k] = motion[0, k] * away[0] + motion[1, k] * away[1] + motion[2, k] * away[2]
    return place
