"""Forward splatting: moves pixels by their flow, and finds pixels that other pixels then hide."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import CHUNK, check_array, first_row
from tisfm.kernels.layout.launch import Kernel

# smallest number of rows of a band. The threads of two neighbouring bands both read the rows near
# the border between them, so bands must be large.
MIN_BAND_ROWS = 96
BLOCK = 64  # px: part of a row that a thread processes at a time


def splat(
    flow: np.ndarray,  # (2, H, W) float32: (u, v), px/frame
    residual: np.ndarray,  # (H, W) float32
    # (H, W, 4) float32: sums over the pixels that arrive: Σw, Σw·residual, Σw·u, Σw·v, with w the
    # bilinear weight. A pixel whose flow leaves the image adds nothing. Allocated by
    # `aligned_empty`.
    sums: np.ndarray,
    *,
    # whether threads add in any order, as on a GPU; rounding then differs between runs
    any_order: bool = False,
) -> None:
    """Add every pixel, bilinearly, to the four pixels of frame 1 around its target position.

    Notes
    -----
    Flow and residual must be finite: with fast math, comparisons with NaN are unreliable.
    """
    _check(flow, residual, sums)
    if any_order:
        _splat_in_any_order(flow, residual, sums)
        return
    height = residual.shape[0]
    max_shift = max(flow[1].max(), -flow[1].min())
    max_row_shift = min(int(max_shift) + 1, height)  # rows that a pixel moves up or down at most
    # An even number of bands, so that two threads have the same number of bands.
    band_pairs = height // (2 * max(MIN_BAND_ROWS, 2 * max_row_shift))
    bands = max(1, 2 * band_pairs)
    _splat(flow, residual, bands, max_row_shift, sums)


def hidden_pixels(
    flow: np.ndarray,  # (2, H, W) float32: (u, v), px/frame
    residual: np.ndarray,  # (H, W) float32
    sums: np.ndarray,  # (H, W, 4) float32: the sums of `splat`
    # (H, W) int32: 1 if more than `density` pixels move to the pixel's target position, their mean
    # flow differs from the pixel's by more than `flow_difference`, and their mean residual is less
    # than the pixel's; else 0. The means include the pixel itself.
    out: np.ndarray,
    *,
    density: float,  # pixels of frame 0 per pixel of frame 1
    # least difference from the mean flow, px/frame. The mean includes the pixel itself: for two
    # pixels with equal weights, their relative motion is twice as large.
    flow_difference: float,
) -> None:
    """Mark the pixels that share their position in frame 1 with other pixels of lower residual."""
    _check(flow, residual, sums)
    check_array(out, residual.shape, "out", dtype=np.int32, aligned=False)
    _hidden_pixels(flow, residual, sums, density, flow_difference, out)


def _check(flow: np.ndarray, residual: np.ndarray, sums: np.ndarray) -> None:
    size = residual.shape
    check_array(residual, size[:2], "residual", aligned=False)
    check_array(flow, (2, *size), "flow", aligned=False)
    check_array(sums, (*size, 4), "sums")


_Sums = ti.types.vector(4, ti.f32)  # one vector load and store each, so it must be aligned


@Kernel
def _splat(
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    residual: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    bands: ti.i32,
    max_row_shift: ti.i32,
    sums: ti.types.ndarray(dtype=_Sums, ndim=2),  # (H, W)
):
    """Add the sums of each band of rows in one thread, so that every sum has a fixed order."""
    height, width = residual.shape[0], residual.shape[1]
    for task in range(CHUNK * bands):
        if task % CHUNK == 0:
            band = task // CHUNK
            first, last = first_row(band, height, bands), first_row(band + 1, height, bands)
            for y, x in ti.ndrange((first, last), width):
                sums[y, x] = _Sums(0.0)
            for y in range(ti.max(0, first - max_row_shift), ti.min(height, last + max_row_shift)):
                for x in range(width):
                    _splat_at(flow, residual, sums, y, x, first, last, False)


@Kernel
def _splat_in_any_order(
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    residual: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    sums: ti.types.ndarray(dtype=_Sums, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(sums.shape[0], sums.shape[1]):
        sums[y, x] = _Sums(0.0)
    for y, x in ti.ndrange(residual.shape[0], residual.shape[1]):
        _splat_at(flow, residual, sums, y, x, 0, residual.shape[0], True)


@ti.func
def _splat_at(
    flow: ti.template(), residual: ti.template(), sums: ti.template(), y, x, first, last,
    atomic: ti.template(),
):  # fmt: skip
    """Add a pixel to the pixels around its target position, in rows `first` to `last` − 1 only."""
    u, v = flow[0, y, x], flow[1, y, x]
    target_x, target_y = x + u, y + v
    if _is_inside(target_x, target_y, residual):
        column, row = ti.cast(target_x, ti.i32), ti.cast(target_y, ti.i32)
        dx, dy = target_x - column, target_y - row
        # Beyond the last row and column there is no neighbour; its weight would be 0.
        below = ti.min(row + 1, residual.shape[0] - 1)
        right = ti.min(column + 1, residual.shape[1] - 1)
        values = _Sums(1.0, residual[y, x], u, v)
        upper, lower = (1.0 - dy) * values, dy * values
        if first <= row and row < last:
            _add(sums, row, column, (1.0 - dx) * upper, atomic)
            _add(sums, row, right, dx * upper, atomic)
        if first <= below and below < last:
            _add(sums, below, column, (1.0 - dx) * lower, atomic)
            _add(sums, below, right, dx * lower, atomic)


@ti.func
def _add(sums: ti.template(), row, column, value, atomic: ti.template()):
    if ti.static(atomic):
        for k in ti.static(range(4)):
            ti.atomic_add(sums[row, column][k], value[k])
    else:  # several times faster than atomic additions
        sums[row, column] = sums[row, column] + value


@Kernel
def _hidden_pixels(
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    residual: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    sums: ti.types.ndarray(dtype=_Sums, ndim=2),  # (H, W)
    density: ti.f32,
    flow_difference: ti.f32,
    out: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
):
    width = residual.shape[1]
    for y, block in ti.ndrange(residual.shape[0], (width + BLOCK - 1) // BLOCK):
        for x in range(block * BLOCK, ti.min((block + 1) * BLOCK, width)):
            u, v = flow[0, y, x], flow[1, y, x]
            target_x, target_y = x + u, y + v
            is_hidden = 0
            if _is_inside(target_x, target_y, residual):
                column, row = ti.cast(target_x, ti.i32), ti.cast(target_y, ti.i32)
                dx, dy = target_x - column, target_y - row
                below = ti.min(row + 1, residual.shape[0] - 1)
                right = ti.min(column + 1, residual.shape[1] - 1)
                upper = (1.0 - dx) * sums[row, column][0] + dx * sums[row, right][0]
                lower = (1.0 - dx) * sums[below, column][0] + dx * sums[below, right][0]
                if (1.0 - dy) * upper + dy * lower > density:  # true at few pixels
                    upper_sums = (1.0 - dx) * sums[row, column] + dx * sums[row, right]
                    lower_sums = (1.0 - dx) * sums[below, column] + dx * sums[below, right]
                    total = (1.0 - dy) * upper_sums + dy * lower_sums
                    du, dv = total[2] / total[0] - u, total[3] / total[0] - v
                    has_larger_residual = residual[y, x] * total[0] > total[1]
                    if (
                        du * du + dv * dv > flow_difference * flow_difference
                        and has_larger_residual
                    ):
                        is_hidden = 1
            out[y, x] = is_hidden


@ti.func
def _is_inside(x, y, image: ti.template()):
    """Return whether a position lies within the centres of the border pixels."""
    is_inside_x = x >= 0 and x <= image.shape[1] - 1
    is_inside_y = y >= 0 and y <= image.shape[0] - 1
    return is_inside_x and is_inside_y
