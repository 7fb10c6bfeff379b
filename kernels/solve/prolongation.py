"""Interpolation of the unknowns from one level of the pyramid to the next finer level."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import (
    LaneArray,
    LaneData,
    LaneGrid,
    check_array,
    lane_count,
    lane_kernel,
    store_lane,
)


def prolong(
    grid: LaneGrid,  # the fine grid
    coarse: np.ndarray,  # (n, h, w) float32
    out: LaneData,  # lane array, n components
    *,
    ratio: float,  # coarse sampling density divided by fine sampling density, at most 1
) -> None:
    """Sample a coarse field bilinearly on a finer grid, halo included.

    Pixel x of the fine grid lies at (x + ½)·ratio − ½ on the coarse grid. Values are divided by
    `ratio`, because the unit of ρ̂ is the pixel of its level.
    """
    check_array(coarse, coarse.shape, "coarse", aligned=False)
    grid.check(out, coarse.shape[0], "out")
    if not 0 < ratio <= 1:
        raise ValueError(f"ratio is {ratio}: expected a value in (0, 1]")
    _prolong[grid.lanes](coarse, ratio, grid.width, out)


@lane_kernel
def _prolong(
    coarse: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (n, h, w)
    ratio: ti.f32,
    width: ti.i32,
    out: LaneArray(3),  # (n, H+2, S+2)
):
    strip = out.shape[2] - 2
    lanes = ti.static(lane_count(out))
    last_row, last_column = coarse.shape[1] - 1, coarse.shape[2] - 1
    for row, position in ti.ndrange(out.shape[1] - 2, strip + 2):
        y = ti.max(0.0, ti.min((row + 0.5) * ratio - 0.5, last_row))
        top = ti.min(ti.cast(y, ti.i32), ti.max(last_row - 1, 0))
        bottom = ti.min(top + 1, last_row)
        down = y - top
        for lane in range(lanes):
            column = lane * strip + position - 1
            x = ti.max(0.0, ti.min((column + 0.5) * ratio - 0.5, last_column))
            left = ti.min(ti.cast(x, ti.i32), ti.max(last_column - 1, 0))
            right = ti.min(left + 1, last_column)
            across = x - left
            for k in range(out.shape[0]):
                value = 0.0
                if column >= 0 and column < width:
                    upper = coarse[k, top, left] * (1.0 - across) + coarse[k, top, right] * across
                    lower = (
                        coarse[k, bottom, left] * (1.0 - across) + coarse[k, bottom, right] * across
                    )
                    value = (upper * (1.0 - down) + lower * down) / ratio
                store_lane(out, k, row + 1, position, lane, value)
