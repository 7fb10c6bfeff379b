"""Transfers of a system and its unknowns to a grid of half the density and back.

Grids and layouts are those of `tisfm.kernels.solve.coarsening`. D and the slopes keep the units of
the finest level. Therefore the weights of all three kinds of edge terms change in the same way: a
coarse weight is half the sum of the two fine weights that it replaces.

Corrections are interpolated so that r stays the same: the slopes bilinearly, and D as their
integral. Between two coarse pixels at distance H, this is linear interpolation plus
−t(1 − t) H Δv/2, with t = ¼ from the nearer pixel.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    INDEX_MASK,
    LaneArray,
    LaneData,
    LaneGrid,
    component_starts,
    element,
    lane_kernel,
    refresh_halo,
)
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.solve.coarsening import check_halved
from tisfm.kernels.solve.second_order.stencil import (
    COMPONENTS,
    WEIGHTS,
    center_at,
    edges_at,
    residual_at,
    stiffness_at,
)


@operation
def coarsen_system(
    grid: LaneGrid,  # the fine grid
    # tensor and weights of a `tisfm.kernels.solve.second_order.system.SecondOrderSystem`, which has
    # checked them
    arrays: tuple[LaneData, ...],
    # coarse_tensor, coarse_weights: halved arrays, 3 and 6 components
    coarse_tensor: LaneData,
    coarse_weights: LaneData,
) -> Launch:
    """Sum the children's data, and combine the weights of edges.

    The energy of a coarse field is then nearly that of its interpolation: the weight of a coarse
    edge is half the sum of two fine weights (`tisfm.kernels.solve.coarsening`). This holds for all
    three kinds of terms, because r, Δv and ΔD all grow with the length of the edge.
    """
    check_halved(grid, coarse_tensor, COMPONENTS, "coarse_tensor")
    check_halved(grid, coarse_weights, WEIGHTS, "coarse_weights")
    return _coarsen_system[grid.lanes].bind(
        *arrays, grid.height, grid.is_serial, coarse_tensor, coarse_weights
    )


@lane_kernel
def _coarsen_system(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    height: ti.i32,
    is_serial: ti.template(),
    coarse_tensor: LaneArray(3),  # (3, h+2, S/2+2)
    coarse_weights: LaneArray(3),  # (6, h+2, S/2+2)
):
    rows, strip = coarse_tensor.shape[1] - 2, coarse_tensor.shape[2] - 2
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(rows, strip):
        y, s = 2 * row + 1, 2 * position + 1
        below = ti.min(y + 1, height + 1)  # below an odd last row: the halo, which is zero
        for k in ti.static(range(COMPONENTS)):
            coarse_tensor[k, row + 1, position + 1] = (
                tensor[k, y, s] + tensor[k, y, s + 1]
                + tensor[k, below, s] + tensor[k, below, s + 1]
            )  # fmt: skip
        for term in ti.static(range(3)):
            east = weights[2 * term, y, s + 1] + weights[2 * term, below, s + 1]
            south = weights[2 * term + 1, below, s] + weights[2 * term + 1, below, s + 1]
            coarse_weights[2 * term, row + 1, position + 1] = 0.5 * east
            coarse_weights[2 * term + 1, row + 1, position + 1] = 0.5 * south
    ti.loop_config(serialize=is_serial)
    for term, row in ti.ndrange(3, rows):
        refresh_halo(coarse_weights, 2 * term, row + 1)


def offset_columns(grid: LaneGrid) -> tuple[np.ndarray, np.ndarray]:
    """Return the offsets of children from the centres of their parents, in fine columns.

    Returns the offset of each child, −½ or ½, 0 for a parent's only child and for padding; and the
    same offset if the parent's neighbour on that side lies outside the image, else 0.
    """
    column = grid.column_index()
    offset = np.where(column % 2 == 0, -0.5, 0.5)
    offset[(column >= grid.width) | ((column == grid.width - 1) & (column % 2 == 0))] = 0
    is_outer = np.zeros_like(offset)
    is_outer[[0, grid.width - 1]] = 1
    return grid.columns(offset), grid.columns(offset * is_outer)


@operation
def restrict_residual(
    grid: LaneGrid,  # the fine grid
    # arrays, scalars: attributes of a `tisfm.kernels.solve.second_order.system.SecondOrderSystem`,
    # which has checked all arrays
    arrays: tuple[LaneData, ...],
    scalars: tuple[float, ...],
    offsets: LaneData,  # the offsets of `offset_columns`
    rho: LaneData,  # lane array, 3 components
    # lane array, 3 components, or None: right-hand side in place of (−B, 0, 0)
    source: LaneData | None,
    out: LaneData,  # halved array, 3 components
) -> Launch:
    """Sum the children's residuals; those of D, times the offsets, are added to the slopes too.

    A slope of the parent is then the slope of a plane through its children. A correction by such a
    plane does not change r on the edges between the children.
    """
    grid.check_columns(offsets, "offsets")
    check_halved(grid, out, COMPONENTS, "out")
    half_h, spread, *_ = scalars
    return _restrict_residual[grid.lanes].bind(
        *arrays, half_h, spread, offsets, rho if source is None else source, rho, grid.height,
        source is not None, grid.is_serial, out,
    )  # fmt: skip


@lane_kernel
def _restrict_residual(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    half_h: ti.f32,
    spread: ti.f32,
    offsets: LaneArray(1),  # (S+2,)
    source: LaneArray(3),  # (3, H+2, S+2), read if `has_source`
    rho: LaneArray(3),  # (3, H+2, S+2)
    height: ti.i32,
    has_source: ti.template(),
    is_serial: ti.template(),
    out: LaneArray(3),  # (3, h+2, S/2+2)
):
    rows, strip = out.shape[1] - 2, out.shape[2] - 2
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(rows, strip):
        stride = rho.shape[2] & INDEX_MASK
        starts = ti.static(component_starts(rho, WEIGHTS))
        depth, east, south = 0.0 * offsets[1], 0.0 * offsets[1], 0.0 * offsets[1]
        # 0 for an only child, which lies at its parent's centre
        has_sibling = ti.cast(2 * row + 1 < height, ti.f32)
        for y in range(2 * row + 1, ti.min(2 * row + 2, height) + 1):
            down = has_sibling * (ti.cast(y - 2 * row, ti.f32) - 1.5)
            for side in ti.static(range(2)):
                s = 2 * position + 1 + side
                i = (y * stride + s) & INDEX_MASK
                center = ti.static(center_at(rho, starts, i))
                edges = ti.static(edges_at(weights, starts, stride, i))
                stiffness = ti.static(stiffness_at(tensor, edges, starts, i, half_h, spread))
                residual = ti.static(
                    residual_at(
                        tensor, edges, stiffness, source if has_source else None, starts, stride,
                        rho, center, i, half_h,
                    )
                )  # fmt: skip
                depth += residual[0]
                east += residual[1] + 2.0 * half_h * offsets[s] * residual[0]
                south += residual[2] + 2.0 * half_h * down * residual[0]
        out[0, row + 1, position + 1] = depth
        out[1, row + 1, position + 1] = east
        out[2, row + 1, position + 1] = south


@operation
def add_correction(
    grid: LaneGrid,  # the fine grid
    # halved array, 3 components: its halo columns must be valid; it is not read beyond the border
    # of the image
    coarse: LaneData,
    # the two tables of `tisfm.kernels.solve.coarsening.interpolation_columns`, and the second table
    # of `offset_columns`
    column_weights: tuple[LaneData, LaneData, LaneData],
    rho: LaneData,  # lane array, 3 components
    *,
    spacing: float,  # h of the fine grid
) -> Launch:
    """Add a coarse correction to D and the slopes, in place, halo included.

    Beyond the outermost coarse pixels D is extrapolated along its slope.
    """
    grid.check(rho, COMPONENTS, "rho")
    check_halved(grid, coarse, COMPONENTS, "coarse")
    for table in column_weights:
        grid.check_columns(table, "column_weights")
    return _add_correction[grid.lanes].bind(
        coarse, *column_weights, grid.height, spacing, grid.is_serial, rho
    )


@lane_kernel
def _add_correction(
    coarse: LaneArray(3),  # (3, h+2, S/2+2)
    parent_weight: LaneArray(1),  # (S+2,)
    neighbour_weight: LaneArray(1),  # (S+2,)
    outer_offset: LaneArray(1),  # (S+2,)
    height: ti.i32,
    spacing: ti.f32,
    is_serial: ti.template(),
    rho: LaneArray(3),  # (3, H+2, S+2), in place
):
    rows, strip = coarse.shape[1] - 2, coarse.shape[2] - 2
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(height, strip):
        stride = coarse.shape[2] & INDEX_MASK
        starts = ti.static(component_starts(coarse, COMPONENTS))
        y = row // 2 + 1
        direction = 2.0 * ti.cast(row % 2, ti.f32) - 1.0
        next_row = ti.max(1, ti.min(y - 1 + 2 * (row % 2), rows))  # y itself at the border
        # An outermost row with a sibling lies half a row beyond its parent.
        extrapolation = 0.0
        if next_row == y and (row % 2 == 1 or row + 1 < height):
            extrapolation = 0.5 * direction
        for side in ti.static(range(2)):  # both children of a row
            s, parent = 2 * position + 1 + side, position + 1
            neighbour = parent - 1 + 2 * side
            tables = ti.static(
                [bind(parent_weight[s]), bind(neighbour_weight[s]), bind(outer_offset[s])]
            )
            first, second = (
                (y * stride + parent) & INDEX_MASK,
                (y * stride + neighbour) & INDEX_MASK,
            )
            parent_row = ti.static(_row_at(coarse, starts, first, second, tables, side, spacing))
            third = (next_row * stride + parent) & INDEX_MASK
            fourth = (next_row * stride + neighbour) & INDEX_MASK
            neighbour_row = ti.static(_row_at(coarse, starts, third, fourth, tables, side, spacing))
            for k in ti.static(range(COMPONENTS)):
                change = 0.75 * parent_row[k] + 0.25 * neighbour_row[k]
                if ti.static(k == 0):
                    change += spacing * (extrapolation * parent_row[2])
                    change += (0.1875 * spacing * direction) * (parent_row[2] - neighbour_row[2])
                rho[k, row + 1, s] = rho[k, row + 1, s] + change
    ti.loop_config(serialize=is_serial)
    for k, row in ti.ndrange(COMPONENTS, height):
        refresh_halo(rho, k, row + 1)


def _row_at(
    coarse: Any, starts: list, first: Any, second: Any, tables: list, side: int, spacing: Any
) -> list:
    """Return the correction of a coarse row at a fine column, while compiling.

    `first` and `second` are the indices for `element` of the parent and of its neighbour.
    """
    parent_weight, neighbour_weight, outer_offset = tables
    parent = [bind(element(coarse, first + starts[k])) for k in range(COMPONENTS)]
    neighbour = [bind(element(coarse, second + starts[k])) for k in range(COMPONENTS)]
    depth, *slopes = (
        parent_weight * a + neighbour_weight * b for a, b in zip(parent, neighbour, strict=True)
    )
    direction = 2.0 * side - 1.0
    # 3/16 of h Δv if there is a neighbour: its weight `neighbour_weight` is ¼, else 0.
    depth = depth + spacing * (
        outer_offset * parent[1]
        + (0.75 * direction) * neighbour_weight * (parent[1] - neighbour[1])
    )
    return [bind(depth), *(bind(slope) for slope in slopes)]
