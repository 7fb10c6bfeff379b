"""The second-order energy as a quadratic function of two steps: a correction and the last step.

D is inverse depth, v₁ and v₂ are its slopes to the east and to the south; an edge joins two
neighbouring pixels (`tisfm.kernels.solve.second_order`). A lane array holds an image as vertical
strips of width S (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    INDEX_MASK,
    LaneArray,
    LaneData,
    LaneGrid,
    SumArray,
    component_starts,
    element,
    lane_count,
    lane_kernel,
    load,
)
from tisfm.kernels.layout.reductions import BLOCK, block_sums, store_sum
from tisfm.kernels.solve.line_search import quadratic_of_sums, size_of  # size_of(x) is |x|
from tisfm.kernels.solve.second_order.stencil import COMPONENTS, WEIGHTS

# sums that give the quadratic function: 3 entries of the matrix, 2 of the vector, and, for each of
# these 2, the sum of the absolute values of its terms
SUM_COUNT = 7


def bind_plane_energy(
    grid: LaneGrid,
    # tensor and weights of a `tisfm.kernels.solve.second_order.system.SecondOrderSystem`, which has
    # checked all arrays
    arrays: tuple[LaneData, ...],
    half_h: float,  # h/2, half the spacing of the grid, px of the finest level
    # correction, previous, step: lane arrays, 3 components: changes or values of D, v₁, v₂
    correction: LaneData,
    previous: LaneData,
    step: LaneData,
) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """Return a function that computes the quadratic energy of previous + p correction + q step.

    The function returns a matrix and a vector, (2, 2) and (2,) float64: the energy changes by zᵀ
    matrix z + 2 zᵀ vector, with z = (p, q).
    """
    partial = block_sums(grid, SUM_COUNT)
    launch = _plane_energy[grid.lanes].bind(
        *arrays, half_h, correction, previous, step, grid.is_serial, partial
    )

    def run() -> tuple[np.ndarray, np.ndarray]:
        launch()
        return quadratic_of_sums(partial)

    return run


@lane_kernel
def _plane_energy(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    half_h: ti.f32,
    correction: LaneArray(3),  # (3, H+2, S+2)
    previous: LaneArray(3),  # (3, H+2, S+2)
    step: LaneArray(3),  # (3, H+2, S+2)
    is_serial: ti.template(),
    partial: SumArray(3),  # (H, blocks, 7)
):
    height, strip = previous.shape[1] - 2, previous.shape[2] - 2
    blocks = partial.shape[1]
    ti.loop_config(serialize=is_serial)
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        stride = previous.shape[2] & INDEX_MASK
        starts = ti.static(component_starts(previous, WEIGHTS))
        sums = ti.static([bind(0.0 * previous[0, row + 1, 1]) for _ in range(SUM_COUNT)])
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            i = ((row + 1) * stride + position + 1) & INDEX_MASK
            a, b = load(tensor, i), load(tensor, i + starts[1])
            previous_depth, correction_depth, step_depth = (
                load(previous, i),
                load(correction, i),
                load(step, i),
            )
            derivative, size = a * previous_depth + b, size_of(a * previous_depth) + size_of(b)
            sums[0] += a * correction_depth * correction_depth
            sums[1] += a * correction_depth * step_depth
            sums[2] += a * step_depth * step_depth
            sums[3] += derivative * correction_depth
            sums[4] += derivative * step_depth
            sums[5] += size * size_of(correction_depth)
            sums[6] += size * size_of(step_depth)
            for side in ti.static(range(2)):  # east, south
                neighbour = i + 1 + side * (stride - 1)
                previous_differences = ti.static(
                    _differences(previous, starts, i, neighbour, side, half_h)
                )
                correction_differences = ti.static(
                    _differences(correction, starts, i, neighbour, side, half_h)
                )
                step_differences = ti.static(_differences(step, starts, i, neighbour, side, half_h))
                for term, weight_index in ti.static(enumerate((0, 1, 1, 2))):  # a, b, b, c
                    weight = load(weights, i + starts[2 * weight_index + side])
                    weighted_correction, weighted_step = (
                        weight * correction_differences[term],
                        weight * step_differences[term],
                    )
                    sums[0] += weighted_correction * correction_differences[term]
                    sums[1] += weighted_correction * step_differences[term]
                    sums[2] += weighted_step * step_differences[term]
                    sums[3] += weighted_correction * previous_differences[term]
                    sums[4] += weighted_step * previous_differences[term]
                    sums[5] += size_of(weighted_correction) * size_of(previous_differences[term])
                    sums[6] += size_of(weighted_step) * size_of(previous_differences[term])
        for term in ti.static(range(SUM_COUNT)):
            store_sum(partial, row, block, term, sums[term], ti.static(lane_count(previous)))


def _differences(array: Any, starts: list, i: Any, j: Any, side: int, half_h: Any) -> list:
    """Return r, Δv₁, Δv₂ and ΔD of an edge, while compiling; `side` is 0 for east, 1 for south.

    r is ΔD minus the change of D that the mean slope along the edge predicts.
    """
    center, neighbour = (
        [bind(element(array, index + starts[k])) for k in range(COMPONENTS)] for index in (i, j)
    )
    step, first, second = (bind(end - start) for end, start in zip(neighbour, center, strict=True))
    return [bind(step - half_h * (center[1 + side] + neighbour[1 + side])), first, second, step]
