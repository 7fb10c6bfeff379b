"""Semi-global aggregation: costs of hypotheses are summed along paths, with a cost for changes.

The costs of a pixel's N hypotheses lie side by side in vectors of `lanes` values, as in a
`LaneGrid`: a float32 array of shape (H, W, N / lanes, lanes), without the last axis for one lane.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import (
    CHUNK,
    LaneArray,
    aligned_empty,
    check_array,
    lane_count,
    lane_kernel,
)
from tisfm.kernels.layout.launch import Kernel

UNUSED_COST = 1e6  # cost of unused elements of vectors; more than any sum along a path
COLUMNS = 32  # columns that a thread processes together, because rows are contiguous in memory
MIN_CURVATURE = 1e-6  # least curvature of the parabola, for hypotheses of equal cost


def aggregate(
    # (H, W, M[, lanes]) float32: C of every pixel and hypothesis; `UNUSED_COST` in unused elements
    # of the last vector
    cost: np.ndarray,
    guide: np.ndarray,  # (H, W) float32: grey levels I of frame 0
    out: np.ndarray,  # the sum of L over the four paths
    *,
    # step, jump: cost of a change by one hypothesis, and of a larger change
    step: float,
    jump: float,
    edge: float,  # difference of grey levels at which a jump has half its cost
) -> None:
    """Sum costs along the four paths through every pixel, from each border of the image.

    Along a path, L(p, n) = C(p, n) + min(L(q, n), L(q, n ± 1) + step, min L(q, ·) + jump') −
    min L(q, ·), where q is the pixel before p and jump' = max(step, jump / (1 + |ΔI| / edge)).

    References
    ----------
    Hirschmüller, "Stereo processing by semiglobal matching and mutual information", PAMI 2008,
    doi 10.1109/TPAMI.2007.1166, eq. 13.
    """
    lanes = 1 if cost.ndim == 3 else cost.shape[3]
    check_array(cost, cost.shape, "cost")
    check_array(out, cost.shape, "out")
    check_array(guide, cost.shape[:2], "guide", aligned=False)
    for by_rows in (True, False):
        lines = cost.shape[0] if by_rows else cost.shape[1]
        path, minima = aligned_empty((lines, *cost.shape[2:])), np.empty(lines, np.float32)
        _aggregate[lanes](cost, guide, path, minima, step, jump, 1 / edge, by_rows, out)


def best_hypothesis(
    cost: np.ndarray,  # (H, W, N) float32
    # (H, W) float32: index of the best hypothesis with a fraction, from 0 to count − 1. If several
    # hypotheses are equally good, the first of them is chosen.
    out: np.ndarray,
    *,
    count: int,  # number of hypotheses, the first of the N elements; at least 2
) -> None:
    """Find the hypothesis of least cost, refined by a parabola through three costs."""
    check_array(cost, cost.shape, "cost")
    check_array(out, cost.shape[:2], "out", aligned=False)
    if not 2 <= count <= cost.shape[2]:
        raise ValueError(f"count is {count}: expected 2 to {cost.shape[2]}")
    _best_hypothesis(cost, count, out)


@Kernel
def _best_hypothesis(
    cost: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, N)
    count: ti.i32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        best, min_cost = 0, cost[y, x, 0]
        for n in range(1, count):
            value = cost[y, x, n]
            if value < min_cost:
                best, min_cost = n, value
        offset = 0.0
        if best > 0 and best < count - 1:
            below, above = cost[y, x, best - 1], cost[y, x, best + 1]
            curvature = ti.max(below + above - 2.0 * min_cost, MIN_CURVATURE)
            offset = ti.max(-0.5, ti.min(0.5 * (below - above) / curvature, 0.5))
        out[y, x] = best + offset


@lane_kernel
def _aggregate(
    cost: LaneArray(3),  # (H, W, M)
    guide: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    path: LaneArray(2),  # (lines, M): L of the previous pixel
    minima: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (lines,): its minimum
    step: ti.f32,
    jump: ti.f32,
    inverse_edge: ti.f32,
    by_rows: ti.template(),
    out: LaneArray(3),  # (H, W, M)
):
    """Sum along rows, writing `out`, or along columns, adding to `out`."""
    lines = path.shape[0]
    if ti.static(lane_count(cost) == 1):  # on a GPU: one thread for each line
        for line in range(lines):
            _sum_lines(
                cost, guide, path, minima, step, jump, inverse_edge, by_rows, out, line, line + 1
            )
    else:
        lines_per_task = ti.static(1 if by_rows else COLUMNS)
        # Taichi gives a thread at least CHUNK iterations. So each thread gets one task.
        for task in range(CHUNK * ((lines + lines_per_task - 1) // lines_per_task)):
            if task % CHUNK == 0:
                first = task // CHUNK * lines_per_task
                end = ti.min(first + lines_per_task, lines)
                _sum_lines(
                    cost, guide, path, minima, step, jump, inverse_edge, by_rows, out, first, end
                )


@ti.func
def _sum_lines(
    cost: ti.template(), guide: ti.template(), path: ti.template(), minima: ti.template(), step,
    jump, inverse_edge, by_rows: ti.template(), out: ti.template(), first, end,
):  # fmt: skip
    """Sum along lines `first` to `end` − 1 of the image, forward and then backward."""
    count = cost.shape[2]
    lanes = ti.static(lane_count(cost))
    length = cost.shape[1] if ti.static(by_rows) else cost.shape[0]
    for direction in range(2):
        is_addition = direction == 1 or ti.static(not by_rows)
        for line in range(first, end):
            minima[line] = 0.0
            for m in range(count):
                path[line, m] = 0.0 * cost[0, 0, m]
        for i in range(length):
            position = i if direction == 0 else length - 1 - i
            previous_position = ti.max(0, ti.min(position - 1 + 2 * direction, length - 1))
            for line in range(first, end):
                y = line if ti.static(by_rows) else position
                x = position if ti.static(by_rows) else line
                difference = guide[y, x] - (
                    guide[y, previous_position]
                    if ti.static(by_rows)
                    else guide[previous_position, x]
                )
                difference = ti.max(difference, 0.0 - difference)
                previous_minimum = minima[line]
                jump_cost = previous_minimum + ti.max(
                    step, jump / (1.0 + inverse_edge * difference)
                )
                previous = 0.0 * cost[y, x, 0] + UNUSED_COST
                current = path[line, 0]
                minimum = 0.0 * current + 2.0 * UNUSED_COST
                for m in range(count):
                    next_ = 0.0 * current + UNUSED_COST
                    if m + 1 < count:
                        next_ = path[line, m + 1]
                    neighbour = ti.min(
                        _shifted_up(previous, current, lanes), _shifted_down(current, next_, lanes)
                    )
                    best = ti.min(ti.min(current, neighbour + step), jump_cost)
                    value = cost[y, x, m] + best - previous_minimum
                    path[line, m] = value
                    if is_addition:
                        out[y, x, m] = out[y, x, m] + value  # not +=, which would be atomic
                    else:
                        out[y, x, m] = value
                    minimum = ti.min(minimum, value)
                    previous, current = current, next_
                minima[line] = _min_of_lanes(minimum, lanes)


@ti.func
def _shifted_up(previous, current, lanes: ti.template()):
    """Return the values of the previous hypothesis for each lane of `current`."""
    result = previous
    if ti.static(lanes > 1):
        result = current
        for lane in ti.static(range(1, lanes)):
            result[lane] = current[lane - 1]
        result[0] = previous[lanes - 1]
    return result


@ti.func
def _shifted_down(current, next_, lanes: ti.template()):
    """Return the values of the next hypothesis for each lane of `current`."""
    result = next_
    if ti.static(lanes > 1):
        result = current
        for lane in ti.static(range(lanes - 1)):
            result[lane] = current[lane + 1]
        result[lanes - 1] = next_[0]
    return result


@ti.func
def _min_of_lanes(value, lanes: ti.template()):
    """Return the smallest value of all lanes."""
    result = 0.0
    if ti.static(lanes > 1):
        result = value[0]
        for lane in ti.static(range(1, lanes)):
            result = ti.min(result, value[lane])
    else:
        result = value
    return result
