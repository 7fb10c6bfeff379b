"""Minimum of the energy in the plane of two directions, as in `tisfm.kernels.solve.line_search`."""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind
from tisfm.kernels.layout.lanes import (
    SMALL,
    LaneArray,
    LaneData,
    LaneGrid,
    SumArray,
    element,
    lane_count,
    lane_kernel,
    load,
    planes_of,
)
from tisfm.kernels.layout.reductions import BLOCK, add_blocks, block_sums, store_sum
from tisfm.kernels.solve.line_search import ROUNDING
from tisfm.kernels.solve.second_order.stencil import COMPONENTS, WEIGHTS

TERMS = 7  # number of sums


def bind_plane(
    grid: LaneGrid,
    # tensor and weights of a `tisfm.kernels.solve.second_order.system.SecondOrderSystem`, which has
    # checked all arrays
    arrays: tuple[LaneData, ...],
    half: float,  # h/2
    # correction, before, step: lane arrays, 3 components
    correction: LaneData,
    before: LaneData,
    step: LaneData,
) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """Return a function that computes the quadratic energy of before + p correction + q step.

    The function returns a matrix and a vector, (2, 2) and (2,) float64: the energy changes by zᵀ
    matrix z + 2 zᵀ vector, with z = (p, q). An entry of the vector that is only rounding error is
    set to 0.
    """
    partial = block_sums(grid, TERMS)
    launch = _plane[grid.lanes].bind(*arrays, half, correction, before, step, grid.serial, partial)

    def run() -> tuple[np.ndarray, np.ndarray]:
        launch()
        a, b, c, *slopes = add_blocks(partial)
        vector, unsigned = np.array(slopes[:2]), np.array(slopes[2:])
        vector[np.abs(vector) <= ROUNDING * unsigned] = 0
        return np.array([[a, b], [b, c]]), vector

    return run


@lane_kernel
def _plane(
    tensor: LaneArray(3),  # (3, H+2, S+2)
    weights: LaneArray(3),  # (6, H+2, S+2)
    half: ti.f32,
    correction: LaneArray(3),  # (3, H+2, S+2)
    before: LaneArray(3),  # (3, H+2, S+2)
    step: LaneArray(3),  # (3, H+2, S+2)
    serial: ti.template(),
    partial: SumArray(3),  # (H, blocks, 7)
):
    height, strip = before.shape[1] - 2, before.shape[2] - 2
    blocks = partial.shape[1]
    ti.loop_config(serialize=serial)
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        stride = before.shape[2] & SMALL
        planes = ti.static(planes_of(before, WEIGHTS))
        sums = ti.static([bind(0.0 * before[0, row + 1, 1]) for _ in range(TERMS)])
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            i = ((row + 1) * stride + position + 1) & SMALL
            a, b = load(tensor, i), load(tensor, i + planes[1])
            old, new, last = load(before, i), load(correction, i), load(step, i)
            slope, size = a * old + b, _size(a * old) + _size(b)
            sums[0] += a * new * new
            sums[1] += a * new * last
            sums[2] += a * last * last
            sums[3] += slope * new
            sums[4] += slope * last
            sums[5] += size * _size(new)
            sums[6] += size * _size(last)
            for side in ti.static(range(2)):  # east, south
                beyond = i + 1 + side * (stride - 1)
                olds = ti.static(_differences(before, planes, i, beyond, side, half))
                news = ti.static(_differences(correction, planes, i, beyond, side, half))
                lasts = ti.static(_differences(step, planes, i, beyond, side, half))
                for term, kind in ti.static(enumerate((0, 1, 1, 2))):
                    weight = load(weights, i + planes[2 * kind + side])
                    change, rest = weight * news[term], weight * lasts[term]
                    sums[0] += change * news[term]
                    sums[1] += change * lasts[term]
                    sums[2] += rest * lasts[term]
                    sums[3] += change * olds[term]
                    sums[4] += rest * olds[term]
                    sums[5] += _size(change) * _size(olds[term])
                    sums[6] += _size(rest) * _size(olds[term])
        for term in ti.static(range(TERMS)):
            store_sum(partial, row, block, term, sums[term], ti.static(lane_count(before)))


def _differences(array: Any, planes: list, i: Any, beyond: Any, side: int, half: Any) -> list:
    """Return r, Δv₁, Δv₂ and ΔD of an edge, while compiling; `side` is 0 for east, 1 for south."""
    here, there = (
        [bind(element(array, place + planes[k])) for k in range(COMPONENTS)]
        for place in (i, beyond)
    )
    step, first, second = (bind(far - near) for far, near in zip(there, here, strict=True))
    return [bind(step - half * (here[1 + side] + there[1 + side])), first, second, step]


@ti.func
def _size(value):
    """Return |value|, in a form that works for vectors of lanes."""
    return ti.max(value, 0.0 - value)
