"""Which pixels of frame 0 go to the same place of frame 1, and which of them is not seen there."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import CHUNK, check_array, first_row
from tisfm.kernels.layout.launch import Kernel

SPLATTING_BAND = 96  # rows, at least: those beside it that reach into a band are gone over again
BLOCK = 64  # pixels of a row that a thread takes at a time


def splat(
    flow: np.ndarray, residual: np.ndarray, sums: np.ndarray, *, any_order: bool = False
) -> None:
    """Add every pixel, bilinearly, to the four pixels of frame 1 around the place it goes to.

    Parameters
    ----------
    flow : (2, H, W) float32
        (u, v), px/frame.
    residual : (H, W) float32
    sums : (H, W, 4) float32
        Sums over the pixels that arrive: Σw, Σw·residual, Σw·u, Σw·v, w the bilinear weight.
        A pixel whose flow leaves the image adds nothing. Allocated by `aligned_empty`.
    any_order : bool
        Whether to add up in parallel, as a GPU must: in an order, and with roundings, that differ
        from run to run.

    Notes
    -----
    Flow and residual must be finite: under fast arithmetic, comparisons with NaN prove nothing.
    """
    _check(flow, residual, sums)
    if any_order:
        _splat_in_any_order(flow, residual, sums)
        return
    height = residual.shape[0]
    farthest = max(flow[1].max(), -flow[1].min())
    reach = min(int(farthest) + 1, height)  # rows that a pixel can go up or down
    # Of bands, so that two threads have as many each.
    pairs = height // (2 * max(SPLATTING_BAND, 2 * reach))
    bands = max(1, 2 * pairs)
    _splat(flow, residual, bands, reach, sums)


def defeated(
    flow: np.ndarray,
    residual: np.ndarray,
    sums: np.ndarray,
    out: np.ndarray,
    *,
    density: float,
    apart: float,
) -> None:
    """Mark the pixels that share their place in frame 1 with others that fit better.

    Parameters
    ----------
    flow : (2, H, W) float32
        (u, v), px/frame.
    residual : (H, W) float32
    sums : (H, W, 4) float32
        Of `splat`.
    out : (H, W) int32
        1 where more than `density` pixels go to the pixel's place, their mean flow is more than
        `apart` from the pixel's, and their mean residual is less than the pixel's; else 0. The
        means include the pixel itself.
    density : float
        Pixels of frame 0 per pixel of frame 1.
    apart : float
        px/frame, from a mean that includes the pixel itself: of two pixels with equal weights,
        one moves by 2·apart relative to the other.
    """
    _check(flow, residual, sums)
    check_array(out, residual.shape, "out", dtype=np.int32, aligned=False)
    _defeated(flow, residual, sums, density, apart, out)


def _check(flow: np.ndarray, residual: np.ndarray, sums: np.ndarray) -> None:
    size = residual.shape
    check_array(residual, size[:2], "residual", aligned=False)
    check_array(flow, (2, *size), "flow", aligned=False)
    check_array(sums, (*size, 4), "sums")


_Sums = ti.types.vector(4, ti.f32)  # loaded and stored at once, so it must be aligned


@Kernel
def _splat(
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    residual: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    bands: ti.i32,
    reach: ti.i32,
    sums: ti.types.ndarray(dtype=_Sums, ndim=2),  # (H, W)
):
    """Add up a band of rows of frame 1 in one thread: the order of every sum is always the same."""
    height, width = residual.shape[0], residual.shape[1]
    for task in range(CHUNK * bands):
        if task % CHUNK == 0:
            band = task // CHUNK
            first, last = first_row(band, height, bands), first_row(band + 1, height, bands)
            for y, x in ti.ndrange((first, last), width):
                sums[y, x] = _Sums(0.0)
            for y in range(ti.max(0, first - reach), ti.min(height, last + reach)):
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
    flow: ti.template(),
    residual: ti.template(),
    sums: ti.template(),
    y,
    x,
    first,
    last,
    atomic: ti.template(),
):
    """Add one pixel to those of the four around the place it goes to whose rows are asked for."""
    u, v = flow[0, y, x], flow[1, y, x]
    target_x, target_y = x + u, y + v
    if _is_inside(target_x, target_y, residual):
        column, row = ti.cast(target_x, ti.i32), ti.cast(target_y, ti.i32)
        across, down = target_x - column, target_y - row
        # The last row and column have no neighbour beyond them, nor any weight for it.
        below = ti.min(row + 1, residual.shape[0] - 1)
        right = ti.min(column + 1, residual.shape[1] - 1)
        weighted = _Sums(1.0, residual[y, x], u, v)
        upper, lower = (1.0 - down) * weighted, down * weighted
        if first <= row and row < last:
            _add(sums, row, column, (1.0 - across) * upper, atomic)
            _add(sums, row, right, across * upper, atomic)
        if first <= below and below < last:
            _add(sums, below, column, (1.0 - across) * lower, atomic)
            _add(sums, below, right, across * lower, atomic)


@ti.func
def _add(sums: ti.template(), row, column, value, atomic: ti.template()):
    if ti.static(atomic):
        for k in ti.static(range(4)):
            ti.atomic_add(sums[row, column][k], value[k])
    else:  # several times faster
        sums[row, column] = sums[row, column] + value


@Kernel
def _defeated(
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    residual: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    sums: ti.types.ndarray(dtype=_Sums, ndim=2),  # (H, W)
    density: ti.f32,
    apart: ti.f32,
    out: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
):
    width = residual.shape[1]
    for y, block in ti.ndrange(residual.shape[0], (width + BLOCK - 1) // BLOCK):
        for x in range(block * BLOCK, ti.min((block + 1) * BLOCK, width)):
            u, v = flow[0, y, x], flow[1, y, x]
            target_x, target_y = x + u, y + v
            loses = 0
            if _is_inside(target_x, target_y, residual):
                column, row = ti.cast(target_x, ti.i32), ti.cast(target_y, ti.i32)
                across, down = target_x - column, target_y - row
                below = ti.min(row + 1, residual.shape[0] - 1)
                right = ti.min(column + 1, residual.shape[1] - 1)
                upper = (1.0 - across) * sums[row, column][0] + across * sums[row, right][0]
                lower = (1.0 - across) * sums[below, column][0] + across * sums[below, right][0]
                if (1.0 - down) * upper + down * lower > density:  # as at few pixels
                    first = (1.0 - across) * sums[row, column] + across * sums[row, right]
                    second = (1.0 - across) * sums[below, column] + across * sums[below, right]
                    total = (1.0 - down) * first + down * second
                    du, dv = total[2] / total[0] - u, total[3] / total[0] - v
                    worse = residual[y, x] * total[0] > total[1]
                    if du * du + dv * dv > apart * apart and worse:
                        loses = 1
            out[y, x] = loses


@ti.func
def _is_inside(x, y, image: ti.template()):
    """Return whether a place lies between the pixels of the border."""
    across = x >= 0 and x <= image.shape[1] - 1
    down = y >= 0 and y <= image.shape[0] - 1
    return across and down
