"""Red–black Gauss–Seidel sweeps over D and its slopes, with over-relaxation."""

from collections.abc import Callable

import taichi as ti

from tisfm.kernels.layout.lanes import (
    CHUNK,
    SMALL,
    LaneArray,
    LaneData,
    LaneGrid,
    first_row,
    lane_kernel,
    planes_of,
    refresh_halo,
    store,
)
from tisfm.kernels.solve.relaxation import AT_ONCE, RELAXATION_BAND, repeated
from tisfm.kernels.solve.second_order.stencil import (
    COMPONENTS,
    WEIGHTS,
    center_at,
    edges_at,
    residual_at,
    solve_at,
    stiffness_at,
)


def bind_sweeps(
    grid: LaneGrid,
    # arrays, numbers: attributes of a `tisfm.kernels.solve.second_order.system.SecondOrderSystem`,
    # which has checked all arrays
    arrays: tuple[LaneData, ...],
    numbers: tuple[float, ...],
    rho: LaneData,  # lane array, 3 components: D, v₁, v₂; modified in place, halo included
    # lane array, 3 components, or None: right-hand side in place of (−B, 0, 0)
    source: LaneData | None,
    *,
    relaxation: float,  # in (0, 2); 1 is Gauss–Seidel
    sweeps: int,
) -> Callable[[], None]:
    """Return a function that runs full red–black sweeps."""
    if not 0 < relaxation < 2:
        raise ValueError(f"relaxation is {relaxation}: expected a value in (0, 2)")
    system = (*arrays, *numbers, rho if source is None else source, relaxation, source is not None)
    if grid.lanes == 1:
        return repeated((_sweep_sites[1].bind(*system, rho), sweeps))
    # Independent of the number of threads, as in `tisfm.kernels.solve.relaxation`.
    bands = max(1, 2 * (grid.height // (2 * RELAXATION_BAND)))
    alone = bands == 1

    def launch(repeats: int) -> Callable[[], None]:
        return _sweep[grid.lanes].bind(*system, alone, bands, repeats, rho)

    if not alone:
        return repeated((launch(1), sweeps))
    whole, rest = divmod(sweeps, AT_ONCE)
    return repeated((launch(AT_ONCE), whole), (launch(rest), min(rest, 1)))


@lane_kernel
def _sweep(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    half: ti.f32,
    spread: ti.f32,
    depth_floor: ti.f32,
    slope_floor: ti.f32,
    source: LaneArray(3),  # (3, H+2, S+2), read if `sourced`
    relaxation: ti.f32,
    sourced: ti.template(),
    alone: ti.template(),
    bands: ti.i32,
    repeats: ti.i32,
    rho: LaneArray(3),  # (3, H+2, S+2), in place
):
    """Sweep in one pass over memory, as `tisfm.kernels.solve.relaxation` does."""
    height = rho.shape[1] - 2
    pairs = (rho.shape[2] - 2) // 2
    chunk = ti.static(1 if alone else CHUNK)
    ti.loop_config(serialize=alone)
    for task in range(chunk * bands):
        if task % chunk == 0:
            stride = rho.shape[2] & SMALL
            planes = ti.static(planes_of(rho, WEIGHTS))
            band = task // chunk
            first, last = first_row(band, height, bands), first_row(band + 1, height, bands)
            first_black = ti.select(band > 0, first + 1, first)
            last_black = ti.select(band < bands - 1, last - 1, last)
            for turn in range(repeats * (2 * (last - first) + 2)):
                step = turn % (2 * (last - first) + 2)
                color = step % 2
                row = first + step // 2 - color
                red = color == 0 and row < last
                black = color == 1 and row >= first_black and row < last_black
                if red or black:
                    for pair in range(pairs):
                        s = 2 * pair + (row + color) % 2 + 1
                        _relax_at(
                            tensor, weights, half, spread, depth_floor, slope_floor, source,
                            stride, planes, relaxation, sourced, rho, row + 1, s,
                        )  # fmt: skip
                    for k in range(COMPONENTS):
                        refresh_halo(rho, k, row + 1)
    # Now the black rows on both sides of every border between bands.
    if ti.static(not alone):
        for task in range(CHUNK * 2 * (bands - 1)):
            if task % CHUNK == 0:
                stride = rho.shape[2] & SMALL
                planes = ti.static(planes_of(rho, WEIGHTS))
                border = task // CHUNK
                row = first_row(border // 2 + 1, height, bands) - 1 + border % 2
                for pair in range(pairs):
                    s = 2 * pair + (row + 1) % 2 + 1
                    _relax_at(
                        tensor, weights, half, spread, depth_floor, slope_floor, source, stride,
                        planes, relaxation, sourced, rho, row + 1, s,
                    )  # fmt: skip
                for k in range(COMPONENTS):
                    refresh_halo(rho, k, row + 1)


@lane_kernel
def _sweep_sites(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    half: ti.f32,
    spread: ti.f32,
    depth_floor: ti.f32,
    slope_floor: ti.f32,
    source: LaneArray(3),  # (3, H+2, S+2), read if `sourced`
    relaxation: ti.f32,
    sourced: ti.template(),
    rho: LaneArray(3),  # (3, H+2, S+2), in place
):
    """Sweep all red and then all black sites, each site in its own thread; for one lane only."""
    height = rho.shape[1] - 2
    pairs = (rho.shape[2] - 2) // 2
    for color in ti.static(range(2)):
        for row, pair in ti.ndrange(height, pairs):
            s = 2 * pair + (row + color) % 2 + 1
            stride = rho.shape[2] & SMALL
            planes = ti.static(planes_of(rho, WEIGHTS))
            _relax_at(
                tensor, weights, half, spread, depth_floor, slope_floor, source, stride, planes,
                relaxation, sourced, rho, row + 1, s,
            )  # fmt: skip


@ti.func
def _relax_at(
    tensor: ti.template(),
    weights: ti.template(),
    half,
    spread,
    depth_floor,
    slope_floor,
    source: ti.template(),
    stride,
    planes: ti.template(),
    relaxation,
    sourced: ti.template(),
    rho: ti.template(),
    y,
    s,
):
    """Solve one pixel (one vector of lanes) with over-relaxation."""
    i = (y * stride + s) & SMALL
    center = ti.static(center_at(rho, planes, i))
    edges = ti.static(edges_at(weights, planes, stride, i))
    held = ti.static(stiffness_at(tensor, edges, planes, i, half, spread))
    residual = ti.static(
        residual_at(
            tensor, edges, held, source if sourced else None, planes, stride, rho, center, i, half
        )
    )
    floors = ti.static((depth_floor, slope_floor))
    step = ti.static(solve_at(tensor, edges, held, planes, residual, i, half, floors))
    for k in ti.static(range(COMPONENTS)):
        store(rho, i + planes[k], center[k] + relaxation * step[k])
