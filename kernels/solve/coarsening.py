"""Transfers of a linear system and its unknowns to a grid of half the density and back (multigrid).

A coarse pixel, the parent, covers 2×2 fine pixels, its children, and has the same centre. Strips of
lanes are halved with the image, so that children lie in the lane of their parent. The coarse arrays
that result have the *halved* layout of the fine grid; its strips are half as long, and may be odd.
If the strips of the coarse grid differ, `relayout` converts between the two layouts.

`prolong` interpolates the unknowns between levels of a pyramid with any ratio of densities.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from dataclasses import replace

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    INDEX_MASK,
    LaneArray,
    LaneData,
    LaneGrid,
    check_array,
    component_starts,
    element,
    lane_count,
    lane_kernel,
    lane_of,
    refresh_halo,
    store_lane,
)
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.model.rigid_motion import motion_columns
from tisfm.kernels.solve.relaxation import edges_at, residual_at


def coarse_grid(grid: LaneGrid) -> LaneGrid:
    """Return the grid of half the density; an odd last row or column has parents of its own."""
    return replace(grid, height=-(-grid.height // 2), width=-(-grid.width // 2))


def halved_shape(grid: LaneGrid, components: int) -> tuple[int, ...]:
    """Return the shape of a halved array of a fine grid."""
    shape = (components, coarse_grid(grid).height + 2, grid.strip_width // 2 + 2)
    return shape if grid.lanes == 1 else (*shape, grid.lanes)


def coarsen_system(
    grid: LaneGrid,  # the fine grid
    # arrays of a `tisfm.kernels.solve.linear_system.LinearSystem`, which has checked them
    arrays: tuple[LaneData, ...],
    # coarse_tensor, coarse_weights: halved arrays, 6 components and as many as the weights
    coarse_tensor: LaneData,
    coarse_weights: LaneData,
) -> None:
    """Sum the children's motion tensors, and combine the weights of edges.

    The energy of a coarse field is then nearly that of its bilinear interpolation. The weight of a
    coarse edge is half the sum of the two fine weights between its pixels: it replaces four fine
    edges, two in each of two rows or columns, and its squared difference is four times theirs.
    """
    tensor, weights = arrays[:2]
    check_halved(grid, coarse_tensor, 6, "coarse_tensor")
    check_halved(grid, coarse_weights, weights.shape[0], "coarse_weights")
    _coarsen_system[grid.lanes](
        tensor, weights, grid.height, weights.shape[0] // 2, coarse_tensor, coarse_weights
    )


@lane_kernel
def _coarsen_system(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    height: ti.i32,
    n: ti.template(),
    coarse_tensor: LaneArray(3),  # (6, h+2, S/2+2)
    coarse_weights: LaneArray(3),  # (2n or 2, h+2, S/2+2)
):
    rows, strip = coarse_tensor.shape[1] - 2, coarse_tensor.shape[2] - 2
    for row, position in ti.ndrange(rows, strip):
        y, s = 2 * row + 1, 2 * position + 1
        below = ti.min(y + 1, height + 1)  # below an odd last row: the halo, which is zero
        for k in ti.static(range(6)):
            coarse_tensor[k, row + 1, position + 1] = (
                tensor[k, y, s] + tensor[k, y, s + 1]
                + tensor[k, below, s] + tensor[k, below, s + 1]
            )  # fmt: skip
        for k in ti.static(range(n)):
            east = weights[k, y, s + 1] + weights[k, below, s + 1]
            south = weights[n + k, below, s] + weights[n + k, below, s + 1]
            coarse_weights[k, row + 1, position + 1] = 0.5 * east
            coarse_weights[n + k, row + 1, position + 1] = 0.5 * south
    for k, row in ti.ndrange(n, rows):
        refresh_halo(coarse_weights, k, row + 1)


def restrict_residual(
    grid: LaneGrid,  # the fine grid
    # arrays of a `tisfm.kernels.solve.linear_system.LinearSystem`, which has checked them
    arrays: tuple[LaneData, ...],
    rho: LaneData,  # lane array, n components
    source: LaneData | None,  # lane array, n components, or None: c in place of −Gᵀj
    out: LaneData,  # halved array, n components
) -> None:
    """Sum the children's residuals c − Bρ̂."""
    components = rho.shape[0]
    check_halved(grid, out, components, "out")
    _restrict_residual[grid.lanes](
        *arrays, rho if source is None else source, rho, grid.height, components,
        arrays[1].shape[0] // 2, source is not None, out,
    )  # fmt: skip


@lane_kernel
def _restrict_residual(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    alpha: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    source: LaneArray(3),  # (n, H+2, S+2), read if `has_source`
    rho: LaneArray(3),  # (n, H+2, S+2)
    height: ti.i32,
    n: ti.template(),
    weight_count: ti.template(),  # weights of an edge: n, or 1
    has_source: ti.template(),
    out: LaneArray(3),  # (n, h+2, S/2+2)
):
    rows, strip = out.shape[1] - 2, out.shape[2] - 2
    for row, position in ti.ndrange(rows, strip):
        alphas = ti.static([bind(alpha[k]) for k in range(n)])
        stride = rho.shape[2] & INDEX_MASK
        starts = ti.static(component_starts(rho, max(6, 2 * weight_count)))
        total = ti.static([bind(0.0 * x_hat[1]) for _ in range(n)])
        for y in range(2 * row + 1, ti.min(2 * row + 2, height) + 1):
            for side in ti.static(range(2)):
                s = 2 * position + 1 + side
                i = (y * stride + s) & INDEX_MASK
                columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
                center = ti.static([bind(element(rho, i + starts[k])) for k in range(n)])
                edges = ti.static(edges_at(weights, starts, stride, weight_count, i))
                residual = ti.static(
                    residual_at(
                        tensor, edges, columns, source if has_source else None, alphas, starts,
                        stride, rho, center, i,
                    )
                )  # fmt: skip
                for k in ti.static(range(n)):
                    total[k] += residual[k]
        for k in ti.static(range(n)):
            out[k, row + 1, position + 1] = total[k]


@operation
def relayout(
    coarse: LaneGrid,  # the grid of the image; one of the two arrays has the strips of this grid
    array: LaneData,  # lane array, k components
    out: LaneData,  # lane array, k components: the padding becomes 0; the halo rows are not written
) -> Launch:
    """Copy a lane array of a grid into strips of another length, halo columns included."""
    for name, layout in (("array", array), ("out", out)):
        shape = (array.shape[0], coarse.height + 2, layout.shape[2])
        check_array(layout, shape if coarse.lanes == 1 else (*shape, coarse.lanes), name)
        if coarse.lanes * (layout.shape[2] - 2) < coarse.width:
            raise ValueError(f"{name} has too few columns for a grid {coarse.width} px wide")
    return _relayout[coarse.lanes].bind(array, coarse.width, coarse.is_serial, out)


@lane_kernel
def _relayout(
    array: LaneArray(3),  # (k, h+2, s+2)
    width: ti.i32,
    is_serial: ti.template(),
    out: LaneArray(3),  # (k, h+2, S+2)
):
    old_strip, new_strip = array.shape[2] - 2, out.shape[2] - 2
    lanes = ti.static(lane_count(out))
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1] - 2, new_strip + 2):
        for lane in ti.static(range(lanes)):
            column = lane * new_strip + position - 1
            is_inside = column >= 0 and column < width
            origin = ti.select(is_inside, column // old_strip, 0)
            position_in_strip = ti.select(is_inside, column - origin * old_strip + 1, 0)
            for k in range(out.shape[0]):
                value = lane_of(array[k, row + 1, position_in_strip], origin, lanes)
                store_lane(out, k, row + 1, position, lane, ti.select(is_inside, value, 0.0))


def add_correction(
    grid: LaneGrid,  # the fine grid
    # halved array, n components: its halo columns must be valid; it is not read beyond the border
    # of the image
    coarse: LaneData,
    # the two tables of `interpolation_columns`
    column_weights: tuple[LaneData, LaneData],
    rho: LaneData,  # lane array, n components
) -> None:
    """Add a coarse correction, interpolated bilinearly, to `rho`, in place, halo included."""
    components = rho.shape[0]
    grid.check(rho, components, "rho")
    check_halved(grid, coarse, components, "coarse")
    for table in column_weights:
        grid.check_columns(table, "column_weights")
    _add_correction[grid.lanes](coarse, *column_weights, grid.height, components, rho)


def interpolation_columns(grid: LaneGrid) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of its parent and of its parent's neighbour for every fine column.

    The weights are ¾ and ¼, or 1 and 0 if the neighbour lies outside the image; 0 for padding.
    """
    column = grid.column_index()
    last = coarse_grid(grid).width - 1
    parent = column // 2
    neighbour = np.where(column % 2 == 0, parent - 1, parent + 1)
    is_inside = column < grid.width
    neighbour_weight = np.where(is_inside & (neighbour >= 0) & (neighbour <= last), 0.25, 0.0)
    return grid.columns(is_inside - neighbour_weight), grid.columns(neighbour_weight)


@lane_kernel
def _add_correction(
    coarse: LaneArray(3),  # (n, h+2, S/2+2)
    parent_weight: LaneArray(1),  # (S+2,)
    neighbour_weight: LaneArray(1),  # (S+2,)
    height: ti.i32,
    n: ti.template(),
    rho: LaneArray(3),  # (n, H+2, S+2), in place
):
    rows, strip = coarse.shape[1] - 2, coarse.shape[2] - 2
    for row, position in ti.ndrange(height, strip):
        y = row // 2 + 1
        next_row = ti.max(1, ti.min(y - 1 + 2 * (row % 2), rows))  # y itself at the border
        for side in ti.static(range(2)):  # both children of a row
            s, parent = 2 * position + 1 + side, position + 1
            neighbour = parent - 1 + 2 * side
            for k in ti.static(range(n)):
                parent_row = (
                    parent_weight[s] * coarse[k, y, parent]
                    + neighbour_weight[s] * coarse[k, y, neighbour]
                )
                neighbour_row = (
                    parent_weight[s] * coarse[k, next_row, parent]
                    + neighbour_weight[s] * coarse[k, next_row, neighbour]
                )
                rho[k, row + 1, s] = rho[k, row + 1, s] + 0.75 * parent_row + 0.25 * neighbour_row
    for k, row in ti.ndrange(n, height):
        refresh_halo(rho, k, row + 1)


def check_halved(grid: LaneGrid, array: LaneData, components: int, name: str) -> None:
    """Raise unless `array` is a halved array of a fine grid."""
    check_array(array, halved_shape(grid, components), name)


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
        dy = y - top
        for lane in range(lanes):
            column = lane * strip + position - 1
            x = ti.max(0.0, ti.min((column + 0.5) * ratio - 0.5, last_column))
            left = ti.min(ti.cast(x, ti.i32), ti.max(last_column - 1, 0))
            right = ti.min(left + 1, last_column)
            dx = x - left
            for k in range(out.shape[0]):
                value = 0.0
                if column >= 0 and column < width:
                    upper = coarse[k, top, left] * (1.0 - dx) + coarse[k, top, right] * dx
                    lower = coarse[k, bottom, left] * (1.0 - dx) + coarse[k, bottom, right] * dx
                    value = (upper * (1.0 - dy) + lower * dy) / ratio
                store_lane(out, k, row + 1, position, lane, value)
