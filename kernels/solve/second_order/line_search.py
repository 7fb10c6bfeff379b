"""The second-order energy as a quadratic function of two steps: a correction and the last step.

D is inverse depth, v₁ and v₂ are its slopes to the east and to the south; an edge joins two
neighbouring pixels (`tisfm.kernels.solve.second_order`). A lane array holds an image as vertical
strips of width S (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind
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
from tisfm.kernels.solve.line_search import quadratic_of_sums, size_of
from tisfm.kernels.solve.second_order.stencil import COMPONENTS, WEIGHTS

SUM_COUNT = 7  # sums that give the quadratic function: 3 entries, 2 slopes and their 2 sizes


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
        *arrays, half_h, correction, previous, step, grid.serial, partial
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
    serial: ti.template(),
    partial: SumArray(3),  # (H, blocks, 7)
):
    height, strip = previous.shape[1] - 2, previous.shape[2] - 2
    blocks = partial.shape[1]
    ti.loop_config(serialize=serial)
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        stride = previous.shape[2] & INDEX_MASK
        starts = ti.static(component_starts(previous, WEIGHTS))
        sums = ti.static([bind(0.0 * previous[0, row + 1, 1]) for _ in range(SUM_COUNT)])
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            i = ((row + 1) * stride + position + 1) & INDEX_MASK
            a, b = load(tensor, i), load(tensor, i + starts[1])
            old_depth, new_depth, last_depth = load(previous, i), load(correction, i), load(step, i)
            slope, size = a * old_depth + b, size_of(a * old_depth) + size_of(b)
            sums[0] += a * new_depth * new_depth
            sums[1] += a * new_depth * last_depth
            sums[2] += a * last_depth * last_depth
            sums[3] += slope * new_depth
            sums[4] += slope * last_depth
            sums[5] += size * size_of(new_depth)
            sums[6] += size * size_of(last_depth)
            for side in ti.static(range(2)):  # east, south
                neighbour = i + 1 + side * (stride - 1)
                old_changes = ti.static(_differences(previous, starts, i, neighbour, side, half_h))
                new_changes = ti.static(
                    _differences(correction, starts, i, neighbour, side, half_h)
                )
                last_changes = ti.static(_differences(step, starts, i, neighbour, side, half_h))
                for term, kind in ti.static(enumerate((0, 1, 1, 2))):
                    weight = load(weights, i + starts[2 * kind + side])
                    change, rest = weight * new_changes[term], weight * last_changes[term]
                    sums[0] += change * new_changes[term]
                    sums[1] += change * last_changes[term]
                    sums[2] += rest * last_changes[term]
                    sums[3] += change * old_changes[term]
                    sums[4] += rest * old_changes[term]
                    sums[5] += size_of(change) * size_of(old_changes[term])
                    sums[6] += size_of(rest) * size_of(old_changes[term])
        for term in ti.static(range(SUM_COUNT)):
            store_sum(partial, row, block, term, sums[term], ti.static(lane_count(previous)))


def _differences(array: Any, starts: list, i: Any, other: Any, side: int, half_h: Any) -> list:
    """Return r, Δv₁, Δv₂ and ΔD of an edge, while compiling; `side` is 0 for east, 1 for south.

    r is ΔD minus the change of D that the mean slope along the edge predicts.
    """
    center, neighbour = (
        [bind(element(array, index + starts[k])) for k in range(COMPONENTS)] for index in (i, other)
    )
    step, first, second = (bind(end - start) for end, start in zip(neighbour, center, strict=True))
    return [bind(step - half_h * (center[1 + side] + neighbour[1 + side])), first, second, step]
