"""Frame 1 brought to frame 0 by the current image motion."""

import taichi as ti

from tisfm.kernels.lanes import (
    LaneArray,
    LaneGrid,
    lane_count,
    lane_kernel,
    lane_of,
    store_lane,
)


def warp(grid: LaneGrid, image, spline, flow, out, mask) -> None:
    """Sample an image at x + flow by its cubic B-spline.

    Fourth-order accurate, smooth, and exact at pixels, where the image itself is taken: no motion
    leaves it as it is, to the last bit. Beyond its border the image repeats.

    Parameters
    ----------
    grid : LaneGrid
    image : (H, W) float32
    spline : (H, W) float32
        Coefficients of its spline, mirrored at the centres of the border pixels.
    flow : lane array, 2 components
        (u, v), px/frame.
    out : (H, W) float32
        The warped image.
    mask : lane array, 1 component
        1 where the pixel lands inside the image, 0 where it leaves it and in the padding.
    """
    grid.check_image(image, "image")
    grid.check_image(spline, "spline")
    grid.check(flow, 2, "flow")
    grid.check_image(out, "out")
    grid.check(mask, 1, "mask")
    _warp[grid.lanes](image, spline, flow, grid.serial, out, mask)


@lane_kernel
def _warp(
    image: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    spline: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    flow: LaneArray(3),  # (2, H+2, S+2)
    serial: ti.template(),
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    mask: LaneArray(3),  # (1, H+2, S+2)
):
    height, width = image.shape[0], image.shape[1]
    strip = flow.shape[2] - 2
    lanes = ti.static(lane_count(flow))
    ti.loop_config(serialize=serial)
    for y, s in ti.ndrange(height, strip):
        u, v = flow[0, y + 1, s + 1], flow[1, y + 1, s + 1]
        for lane in ti.static(range(lanes)):
            x = lane * strip + s
            inside = 0.0
            if x < width:
                target_x = x + lane_of(u, lane, lanes)
                target_y = y + lane_of(v, lane, lanes)
                across = target_x >= 0 and target_x <= width - 1
                down = target_y >= 0 and target_y <= height - 1
                if across and down:
                    inside = 1.0
                out[y, x] = _sample(image, spline, target_x, target_y)
            store_lane(mask, 0, y + 1, s + 1, lane, inside)


@ti.func
def _sample(image: ti.template(), spline: ti.template(), x, y):
    height, width = image.shape[0], image.shape[1]
    x = ti.max(0.0, ti.min(x, width - 1.0))
    y = ti.max(0.0, ti.min(y, height - 1.0))
    left, top = ti.floor(x), ti.floor(y)
    column, row = ti.cast(left, ti.i32), ti.cast(top, ti.i32)
    value = 0.0
    if x == left and y == top:
        value = image[row, column]
    else:
        weight_x = _weights(x - left)
        weight_y = _weights(y - top)
        if column >= 1 and column < width - 2 and row >= 1 and row < height - 2:
            # Four neighbours at once: the sum of four rows, then that of four columns.
            first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
            for j in ti.static(range(4)):
                first += weight_y[j] * spline[row + j - 1, column - 1]
                second += weight_y[j] * spline[row + j - 1, column]
                third += weight_y[j] * spline[row + j - 1, column + 1]
                fourth += weight_y[j] * spline[row + j - 1, column + 2]
            value = (
                weight_x[0] * first + weight_x[1] * second
                + weight_x[2] * third + weight_x[3] * fourth
            )  # fmt: skip
        else:
            columns = ti.Vector([_mirror(column + i - 1, width) for i in ti.static(range(4))])
            for j in ti.static(range(4)):
                yy = _mirror(row + j - 1, height)
                line = 0.0
                for i in ti.static(range(4)):
                    line += weight_x[i] * spline[yy, columns[i]]
                value += weight_y[j] * line
    return value


@ti.func
def _mirror(index, size):
    """Return an index at most two beyond the border, mirrored at the border pixel's centre."""
    index = ti.select(index < 0, -index, index)
    index = ti.select(index > size - 1, 2 * (size - 1) - index, index)
    return ti.max(index, 0)


@ti.func
def _weights(t):
    """Return the four values of the cubic B-spline for a sample a fraction t past the second."""
    s = 1.0 - t
    return ti.Vector(
        [
            s * s * s / 6.0,
            2.0 / 3.0 - t * t * (1.0 - 0.5 * t),
            2.0 / 3.0 - s * s * (1.0 - 0.5 * s),
            t * t * t / 6.0,
        ]
    )
