"""Warping of frame 1 to frame 0 by the current image motion.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from typing import Any

import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    CHUNK,
    LaneArray,
    LaneData,
    LaneGrid,
    check_array,
    first_row,
    lane_count,
    lane_kernel,
    lane_of,
    set_lane,
)
from tisfm.kernels.layout.launch import Launch, operation

WARP_BAND = 16  # smallest number of rows of a band


@operation
def warp(
    grid: LaneGrid,
    image: LaneData,  # (H, W) float32
    # ((H + 3)·W, 4) float32: spline coefficients of the image, four neighbouring columns in each
    # row (`tisfm.solver.sampling.spline_taps`); on a device, an array of vectors
    taps: LaneData,
    flow: LaneData,  # lane array, 2 components: (u, v), px/frame
    # lane array, 1 component, any halo: the warped image; halo and padding repeat its border
    out: LaneData,
    # lane array, 1 component: 1 where the pixel stays inside the image, 0 where it leaves the
    # image and in the padding
    mask: LaneData,
) -> Launch:
    """Sample an image at x + flow by its cubic B-spline.

    Sampling is smooth and fourth-order accurate. At whole pixels the image value itself is taken,
    so zero flow returns exactly the image. The border of the image is repeated.
    """
    grid.check_image(image, "image")
    check_array(taps, ((grid.height + 3) * grid.width, 4), "taps")
    grid.check(flow, 2, "flow")
    halo = (out.shape[1] - grid.height) // 2
    grid.check(out, 1, "out", halo=halo)
    grid.check(mask, 1, "mask")
    if grid.lanes == 1:
        return _warp_sites[1].bind(image, taps, flow, halo, out, mask)
    bands = 1 if grid.is_serial else max(1, grid.height // WARP_BAND)
    return _warp[grid.lanes].bind(image, taps, flow, halo, grid.is_serial, bands, out, mask)


_Taps = ti.types.vector(4, ti.f32)  # one vector load, so it must be aligned


@lane_kernel
def _warp(
    image: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    taps: ti.types.ndarray(dtype=_Taps, ndim=1),  # ((H+3)·W,)
    flow: LaneArray(3),  # (2, H+2, S+2)
    halo: ti.i32,
    is_serial: ti.template(),
    bands: ti.i32,
    out: LaneArray(3),  # (1, H+2·halo, S+2·halo)
    mask: LaneArray(3),  # (1, H+2, S+2)
):
    """Warp a band of rows in one thread; borders are written while their row is in the cache."""
    height, width = image.shape[0], image.shape[1]
    strip = flow.shape[2] - 2
    lanes = ti.static(lane_count(flow))
    chunk = ti.static(1 if is_serial else CHUNK)
    ti.loop_config(serialize=is_serial)
    for task in range(chunk * bands):
        if task % chunk == 0:
            band = task // chunk
            first_columns = 0.0 * flow[0, 0, 0]  # of the strips
            for lane in ti.static(range(lanes)):
                first_columns[lane] = lane * strip
            for y in range(first_row(band, height, bands), first_row(band + 1, height, bands)):
                for s in range(strip):
                    u, v = flow[0, y + 1, s + 1], flow[1, y + 1, s + 1]
                    warped, inside_mask = _sample(image, taps, first_columns + s, y, u, v, lanes)
                    out[0, y + halo, s + halo] = warped
                    mask[0, y + 1, s + 1] = inside_mask
                _repeat_columns(out, y + halo, halo, first_columns, width)
                if y == 0:
                    for k, position in ti.ndrange(halo, out.shape[2]):
                        out[0, k, position] = out[0, halo, position]
                if y == height - 1:
                    for k, position in ti.ndrange(halo, out.shape[2]):
                        out[0, height + halo + k, position] = out[0, y + halo, position]


@lane_kernel
def _warp_sites(
    image: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    taps: ti.types.ndarray(dtype=_Taps, ndim=1),  # ((H+3)·W,)
    flow: LaneArray(3),  # (2, H+2, S+2)
    halo: ti.i32,
    out: LaneArray(3),  # (1, H+2·halo, S+2·halo)
    mask: LaneArray(3),  # (1, H+2, S+2)
):
    """Warp every element of `out`, border included, in its own thread; for one lane only."""
    height, width = image.shape[0], image.shape[1]
    strip = flow.shape[2] - 2
    for row, position in ti.ndrange(out.shape[1], out.shape[2]):
        y = ti.max(0, ti.min(row - halo, height - 1))
        x = ti.max(0, ti.min(position - halo, width - 1))
        u, v = flow[0, y + 1, x + 1], flow[1, y + 1, x + 1]
        warped, inside_mask = _sample(image, taps, ti.cast(x, ti.f32), y, u, v, 1)
        out[0, row, position] = warped
        if row == y + halo and position >= halo and position < strip + halo:
            mask[0, y + 1, position - halo + 1] = ti.select(x == position - halo, inside_mask, 0.0)


@ti.func
def _sample(image: ti.template(), taps: ti.template(), column, row, u, v, lanes: ti.template()):
    """Return the samples at the targets of a row's pixels, and the mask; a value per lane."""
    height, width = image.shape[0], image.shape[1]
    target_x, target_y = column + u, row + v
    x = ti.max(0.0, ti.min(target_x, width - 1.0))
    y = ti.max(0.0, ti.min(target_y, height - 1.0))
    zero, one = 0.0 * x, 0.0 * x + 1.0
    inside_mask = ti.select(column < width, one, zero)
    inside_mask = ti.select(x == target_x, inside_mask, zero)
    inside_mask = ti.select(y == target_y, inside_mask, zero)
    left, top = ti.floor(x), ti.floor(y)
    dx, dy = x - left, y - top
    weights_x, weights_y = ti.static(_weights(dx)), ti.static(_weights(dy))
    # weighted sums of the coefficients over four rows, for each of four columns
    columns = ti.static([bind(zero) for _ in range(4)])
    for lane in range(lanes):
        corner = _index(top, lane, lanes) * width + _index(left, lane, lanes)
        total = lane_of(weights_y[0], lane, lanes) * taps[corner]
        for k in ti.static(range(1, 4)):
            total += lane_of(weights_y[k], lane, lanes) * taps[corner + k * width]
        for k in ti.static(range(4)):
            set_lane(columns[k], lane, lanes, total[k])
    value = weights_x[0] * columns[0]
    for k in ti.static(range(1, 4)):
        value += weights_x[k] * columns[k]
    for lane in range(lanes):
        if lane_of(dx, lane, lanes) + lane_of(dy, lane, lanes) == 0.0:
            pixel = image[_index(top, lane, lanes), _index(left, lane, lanes)]
            set_lane(value, lane, lanes, pixel)
    return value, inside_mask


@ti.func
def _index(value, lane: ti.template(), lanes: ti.template()):
    return ti.cast(lane_of(value, lane, lanes), ti.i32)


def _weights(t: Any) -> list:
    """Return the four cubic B-spline weights for a sample a fraction t after the second tap."""
    s = bind(1.0 - t)
    return [
        bind(s * s * s / 6.0),
        bind(2.0 / 3.0 - t * t * (1.0 - 0.5 * t)),
        bind(2.0 / 3.0 - s * s * (1.0 - 0.5 * s)),
        bind(t * t * t / 6.0),
    ]


@ti.func
def _repeat_columns(array: ti.template(), row, halo, first_columns, width):
    """Write padding and halo of a row whose pixels are already written.

    The padding repeats the image's last column, the halo the columns of the neighbouring strips.
    """
    strip = array.shape[2] - 2 * halo
    lanes = ti.static(lane_count(array))
    if width < lanes * strip:
        last = array[0, row, (width - 1) % strip + halo][(width - 1) // strip]
        for s in range(strip):
            value = array[0, row, s + halo]
            array[0, row, s + halo] = ti.select(
                first_columns + s < width, value, 0.0 * value + last
            )
    # From the inside outwards: a neighbouring strip may be narrower than the halo.
    for k in range(halo):
        west, east = halo - 1 - k, strip + halo + k
        western_neighbours, eastern_neighbours = (
            array[0, row, west + strip],
            array[0, row, east - strip],
        )
        west_values, east_values = array[0, row, west + 1], array[0, row, east - 1]
        for lane in range(lanes - 1):
            west_values[lane + 1] = western_neighbours[lane]
            east_values[lane] = eastern_neighbours[lane + 1]
        array[0, row, west] = west_values
        array[0, row, east] = east_values
