"""Red–black Gauss–Seidel sweeps over D and its slopes, with over-relaxation.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable

import taichi as ti

from tisfm.kernels.layout.lanes import (
    CHUNK,
    INDEX_MASK,
    LaneArray,
    LaneData,
    LaneGrid,
    component_starts,
    first_row,
    lane_kernel,
    refresh_halo,
    store,
)
from tisfm.kernels.solve.relaxation import repeat_launches, sweeps_in_bands
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
    # arrays, scalars: attributes of a `tisfm.kernels.solve.second_order.system.SecondOrderSystem`,
    # which has checked all arrays
    arrays: tuple[LaneData, ...],
    scalars: tuple[float, ...],
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
    system = (*arrays, *scalars, rho if source is None else source, relaxation, source is not None)
    if grid.lanes == 1:
        return repeat_launches((_sweep_sites[1].bind(*system, rho), sweeps))
    return sweeps_in_bands(_sweep[grid.lanes], system, rho, grid.height, sweeps)


@lane_kernel
def _sweep(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    half_h: ti.f32,
    spread: ti.f32,
    depth_floor: ti.f32,
    slope_floor: ti.f32,
    source: LaneArray(3),  # (3, H+2, S+2), read if `has_source`
    relaxation: ti.f32,
    has_source: ti.template(),
    is_single: ti.template(),
    bands: ti.i32,
    repeats: ti.i32,
    rho: LaneArray(3),  # (3, H+2, S+2), in place
):
    """Sweep in one pass over memory, as `tisfm.kernels.solve.relaxation` does."""
    height = rho.shape[1] - 2
    pairs = (rho.shape[2] - 2) // 2
    chunk = ti.static(1 if is_single else CHUNK)
    ti.loop_config(serialize=is_single)
    for task in range(chunk * bands):
        if task % chunk == 0:
            stride = rho.shape[2] & INDEX_MASK
            starts = ti.static(component_starts(rho, WEIGHTS))
            band = task // chunk
            first, last = first_row(band, height, bands), first_row(band + 1, height, bands)
            first_black = ti.select(band > 0, first + 1, first)
            last_black = ti.select(band < bands - 1, last - 1, last)
            for tick in range(repeats * (2 * (last - first) + 2)):
                step = tick % (2 * (last - first) + 2)
                color = step % 2
                row = first + step // 2 - color
                is_red = color == 0 and row < last
                is_black = color == 1 and row >= first_black and row < last_black
                if is_red or is_black:
                    for pair in range(pairs):
                        s = 2 * pair + (row + color) % 2 + 1
                        _relax_at(
                            tensor, weights, half_h, spread, depth_floor, slope_floor, source,
                            stride, starts, relaxation, has_source, rho, row + 1, s,
                        )  # fmt: skip
                    for k in range(COMPONENTS):
                        refresh_halo(rho, k, row + 1)
    # Now the black rows on both sides of every border between bands.
    if ti.static(not is_single):
        for task in range(CHUNK * 2 * (bands - 1)):
            if task % CHUNK == 0:
                stride = rho.shape[2] & INDEX_MASK
                starts = ti.static(component_starts(rho, WEIGHTS))
                border = task // CHUNK
                row = first_row(border // 2 + 1, height, bands) - 1 + border % 2
                for pair in range(pairs):
                    s = 2 * pair + (row + 1) % 2 + 1
                    _relax_at(
                        tensor, weights, half_h, spread, depth_floor, slope_floor, source, stride,
                        starts, relaxation, has_source, rho, row + 1, s,
                    )  # fmt: skip
                for k in range(COMPONENTS):
                    refresh_halo(rho, k, row + 1)


@lane_kernel
def _sweep_sites(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    half_h: ti.f32,
    spread: ti.f32,
    depth_floor: ti.f32,
    slope_floor: ti.f32,
    source: LaneArray(3),  # (3, H+2, S+2), read if `has_source`
    relaxation: ti.f32,
    has_source: ti.template(),
    rho: LaneArray(3),  # (3, H+2, S+2), in place
):
    """Sweep all red and then all black sites, each site in its own thread; for one lane only."""
    height = rho.shape[1] - 2
    pairs = (rho.shape[2] - 2) // 2
    for color in ti.static(range(2)):
        for row, pair in ti.ndrange(height, pairs):
            s = 2 * pair + (row + color) % 2 + 1
            stride = rho.shape[2] & INDEX_MASK
            starts = ti.static(component_starts(rho, WEIGHTS))
            _relax_at(
                tensor, weights, half_h, spread, depth_floor, slope_floor, source, stride, starts,
                relaxation, has_source, rho, row + 1, s,
            )  # fmt: skip


@ti.func
def _relax_at(
    tensor: ti.template(), weights: ti.template(), half_h, spread, depth_floor, slope_floor,
    source: ti.template(), stride, starts: ti.template(), relaxation, has_source: ti.template(),
    rho: ti.template(), y, s,
):  # fmt: skip
    """Solve one pixel (one vector of lanes) with over-relaxation."""
    i = (y * stride + s) & INDEX_MASK
    center = ti.static(center_at(rho, starts, i))
    edges = ti.static(edges_at(weights, starts, stride, i))
    stiffness = ti.static(stiffness_at(tensor, edges, starts, i, half_h, spread))
    residual = ti.static(
        residual_at(
            tensor,
            edges,
            stiffness,
            source if has_source else None,
            starts,
            stride,
            rho,
            center,
            i,
            half_h,
        )
    )
    floors = ti.static((depth_floor, slope_floor))
    step = ti.static(solve_at(tensor, edges, stiffness, starts, residual, i, half_h, floors))
    for k in ti.static(range(COMPONENTS)):
        store(rho, i + starts[k], center[k] + relaxation * step[k])
