"""The image-driven factor of smoothness: it is smaller across contours of the image.

Here an edge joins two neighbouring pixels. A lane array holds an image of width W as vertical
strips of width S (`tisfm.kernels.layout.lanes`).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import (
    LaneArray,
    LaneData,
    LaneGrid,
    SumArray,
    lane_count,
    lane_kernel,
)
from tisfm.kernels.layout.reductions import BLOCK, add_blocks, block_sums, store_sum
from tisfm.kernels.model import MIN_DIVISOR


def image_edges(
    grid: LaneGrid,
    image: np.ndarray,  # (H, W) float32: grey levels
    # lane array, 2 components: g of eastern and southern edges; 0 across the border and outside
    # the image. The halo is not written.
    out: LaneData,
    *,
    rate: float,  # growth of the divisor of g, per grey level
) -> None:
    """Compute g = c/(1 + rate·|ΔI|) of every edge, with c such that the mean of g is 1."""
    grid.check_image(image, "image")
    grid.check(out, 2, "out")
    if not 0 <= rate < float("inf"):
        raise ValueError(f"rate is {rate}: expected a number of at least 0, per grey level")
    partial = block_sums(grid, 1)
    _image_edges[grid.lanes](image, rate, grid.is_serial, out, partial)
    count = grid.height * (grid.width - 1) + (grid.height - 1) * grid.width
    mean = float(add_blocks(partial)[0]) / max(count, 1)
    _scale[grid.lanes](1.0 / max(mean, MIN_DIVISOR), grid.is_serial, out)


@lane_kernel
def _image_edges(
    image: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    rate: ti.f32,
    is_serial: ti.template(),
    # (2, H+2, S+2); finite on input: 0 times an element makes a zero of the type of lanes
    out: LaneArray(3),
    partial: SumArray(3),  # (H, blocks, 1)
):
    height, width = image.shape[0], image.shape[1]
    strip, blocks = out.shape[2] - 2, partial.shape[1]
    lanes = ti.static(lane_count(out))
    ti.loop_config(serialize=is_serial)
    for row, block in ti.ndrange(height, blocks):
        zero = 0.0 * out[0, row + 1, 1]
        below = ti.min(row + 1, height - 1)
        has_row_below = ti.cast(row < height - 1, ti.f32)
        center = _lane_values(image, row, block * BLOCK, strip, zero, lanes)
        total = zero
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            right = _lane_values(image, row, position + 1, strip, zero, lanes)
            down = _lane_values(image, below, position, strip, zero, lanes)
            east = _is_before(width - 1, position, strip, zero, lanes)
            east /= 1.0 + rate * ti.max(right - center, center - right)
            south = has_row_below * _is_before(width, position, strip, zero, lanes)
            south /= 1.0 + rate * ti.max(down - center, center - down)
            out[0, row + 1, position + 1] = east
            out[1, row + 1, position + 1] = south
            total += east + south
            center = right
        store_sum(partial, row, block, 0, total, lanes)


@ti.func
def _lane_values(image: ti.template(), y, position, strip, zero, lanes: ti.template()):
    """Return the values of one column of each strip in a row; the image border is repeated."""
    values = zero
    last = image.shape[1] - 1
    if ti.static(lanes > 1):
        for lane in range(lanes):
            values[lane] = image[y, ti.min(lane * strip + position, last)]
    else:
        values = image[y, ti.min(position, last)]
    return values


@ti.func
def _is_before(end, position, strip, zero, lanes: ti.template()):
    """Return, for each strip, 1 if its column at `position` is left of column `end`, else 0."""
    values = zero
    if ti.static(lanes > 1):
        for lane in range(lanes):
            values[lane] = ti.select(lane * strip + position < end, 1.0, 0.0)
    else:
        values = ti.select(position < end, 1.0, 0.0)
    return values


@lane_kernel
def _scale(
    factor: ti.f32,
    is_serial: ti.template(),
    out: LaneArray(3),  # (2, H+2, S+2), in place
):
    ti.loop_config(serialize=is_serial)
    for k, row in ti.ndrange(out.shape[0], out.shape[1] - 2):
        for position in range(out.shape[2] - 2):
            out[k, row + 1, position + 1] = factor * out[k, row + 1, position + 1]
