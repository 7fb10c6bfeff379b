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


def warp(grid: LaneGrid, image, flow, out, mask) -> None:
    """Sample an image at x + flow by bicubic convolution.

    Keys' kernel with a = −½ (doi 10.1109/TASSP.1981.1163711), third-order accurate and exact at
    pixels. Beyond its border the image repeats.

    The mask tells of the pixel itself, not of its neighbours, whose repeated values derivatives
    see near the border. Leaving out every pixel of which one tap lies outside was tried: what is
    lost there is worth more than what is wrong (README).

    Parameters
    ----------
    grid : LaneGrid
    image : (H, W) float32
    flow : lane array, 2 components
        (u, v), px/frame.
    out : (H, W) float32
        The warped image.
    mask : lane array, 1 component
        1 where the pixel lands inside the image, 0 where it leaves it and in the padding.
    """
    grid.check_image(image, "image")
    grid.check(flow, 2, "flow")
    grid.check_image(out, "out")
    grid.check(mask, 1, "mask")
    _warp[grid.lanes](image, flow, out, mask)


@lane_kernel
def _warp(
    image: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    flow: LaneArray(3),  # (2, H+2, S+2)
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    mask: LaneArray(3),  # (1, H+2, S+2)
):
    height, width = image.shape[0], image.shape[1]
    strip = flow.shape[2] - 2
    lanes = ti.static(lane_count(flow))
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
                out[y, x] = _bicubic(image, target_x, target_y)
            store_lane(mask, 0, y + 1, s + 1, lane, inside)


@ti.func
def _bicubic(image: ti.template(), x, y):
    height, width = image.shape[0], image.shape[1]
    # Far outside, the position itself would overflow an index: any such pixel sees the border.
    x = ti.max(-2.0, ti.min(x, width + 1.0))
    y = ti.max(-2.0, ti.min(y, height + 1.0))
    left, top = ti.floor(x), ti.floor(y)
    weight_x = _keys(x - left)
    weight_y = _keys(y - top)
    column, row = ti.cast(left, ti.i32), ti.cast(top, ti.i32)
    total = 0.0
    for j in ti.static(range(4)):
        yy = ti.max(0, ti.min(row + j - 1, height - 1))
        line = 0.0
        for i in ti.static(range(4)):
            xx = ti.max(0, ti.min(column + i - 1, width - 1))
            line += weight_x[i] * image[yy, xx]
        total += weight_y[j] * line
    return total


@ti.func
def _keys(t):
    """Return the four weights for a sample a fraction t past the second of four pixels."""
    return ti.Vector(
        [
            t * (-0.5 + t * (1.0 - 0.5 * t)),
            1.0 + t * t * (1.5 * t - 2.5),
            t * (0.5 + t * (2.0 - 1.5 * t)),
            t * t * (0.5 * t - 0.5),
        ]
    )
