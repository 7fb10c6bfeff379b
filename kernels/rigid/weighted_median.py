"""Median of neighbours that look like a pixel: surfaces end where the grey level changes."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

HALVINGS = 6  # of the range of the values in a window


def weighted_median(
    values: np.ndarray,  # (H, W) float32; positive
    frame: np.ndarray,  # (H, W) float32: grey levels
    is_smoothed: np.ndarray,  # (H, W) int32: 0 for pixels that keep their value
    is_used: np.ndarray,  # (H, W) int32: 0 for pixels that do not count as neighbours
    out: np.ndarray,  # (H, W) float32; it must not be `values`
    *,
    radius: int,  # px: half the side of the window
    grey_scale: float,  # difference of grey levels at which a neighbour has half its weight
    same_share: float,  # difference from a pixel's own value, as a share of it, that is none
    max_own_weight: float,  # share of the weight: a pixel with more for its own value keeps it
) -> None:
    """Replace values that few neighbours share by a weighted median of the neighbours.

    A pixel keeps its value if neighbours with about this value, and itself, have more than
    `max_own_weight` of the weight.

    The weight of a neighbour is 1 / (1 + (difference / `grey_scale`)²). The range of the values in
    a window is halved `HALVINGS` times; the result is the least value in the last part. So values
    that differ by more than range / 2^`HALVINGS` are told apart.

    References
    ----------
    Ma, He, Wei, Sun, Wu, "Constant time weighted median filtering for stereo matching and beyond",
    ICCV 2013, doi 10.1109/ICCV.2013.13: such a filter makes outlines of depth sharp.
    """
    shape = values.shape
    for name, array in (("values", values), ("frame", frame), ("out", out)):
        check_array(array, shape, name, aligned=False)
    check_array(is_smoothed, shape, "is_smoothed", dtype=np.int32, aligned=False)
    check_array(is_used, shape, "is_used", dtype=np.int32, aligned=False)
    if np.shares_memory(values, out):
        raise ValueError("out is values: expected another array")
    if radius < 0 or grey_scale <= 0:
        raise ValueError(f"radius is {radius}, grey_scale {grey_scale}: expected ≥ 0 and > 0")
    _weighted_median(
        values, frame, is_smoothed, is_used, radius, 1 / grey_scale, same_share, max_own_weight, out
    )


@Kernel
def _weighted_median(
    values: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    frame: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    is_smoothed: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
    is_used: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
    radius: ti.i32,
    scale: ti.f32,
    same_share: ti.f32,
    max_own_weight: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    height, width = values.shape[0], values.shape[1]
    for y, x in ti.ndrange(height, width):
        value = values[y, x]
        if is_smoothed[y, x] > 0:
            grey = frame[y, x]
            top, bottom = ti.max(0, y - radius), ti.min(height, y + radius + 1)
            left, right = ti.max(0, x - radius), ti.min(width, x + radius + 1)
            least, most, total, own = value, value, 0.0, 0.0
            for row, column in ti.ndrange((top, bottom), (left, right)):
                if is_used[row, column] > 0:
                    other = values[row, column]
                    least, most = ti.min(least, other), ti.max(most, other)
                    weight = _likeness(scale * (frame[row, column] - grey))
                    total += weight
                    if ti.abs(other - value) <= same_share * value:
                        own += weight
            if own <= max_own_weight * total:
                # The median is above `low`, and at most `high`, or it is the least value.
                low, high = least, most
                for _ in range(HALVINGS):
                    middle, below = 0.5 * (low + high), 0.0
                    for row, column in ti.ndrange((top, bottom), (left, right)):
                        if is_used[row, column] > 0 and values[row, column] <= middle:
                            below += _likeness(scale * (frame[row, column] - grey))
                    if below < 0.5 * total:
                        low = middle
                    else:
                        high = middle
                value = most
                for row, column in ti.ndrange((top, bottom), (left, right)):
                    other = values[row, column]
                    if is_used[row, column] > 0 and (other > low or low == least):
                        value = ti.min(value, other)
        out[y, x] = value


@ti.func
def _likeness(difference):
    """Return the weight of a neighbour, from its difference in units of the scale."""
    return 1.0 / (1.0 + difference * difference)
