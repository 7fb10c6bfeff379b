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

FORBIDDEN = 1e6  # cost of unused places in vectors; more than any sum along a path
COLUMNS = 32  # columns that a thread processes together, because rows are contiguous in memory
LEAST_BEND = 1e-6  # least curvature of the parabola, for hypotheses of equal cost


def aggregate(
    # (H, W, M[, lanes]) float32: C of every pixel and hypothesis; `FORBIDDEN` in unused places of
    # the last vector
    cost: np.ndarray,
    guide: np.ndarray,  # (H, W) float32: grey levels I of frame 0
    out: np.ndarray,  # the sum of L over the four paths
    *,
    # step, jump: cost of a change by one hypothesis, and of a larger change
    step: float,
    jump: float,
    edge: float,  # step of grey levels at which a jump has half its cost
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
    for across in (True, False):
        lines = cost.shape[0] if across else cost.shape[1]
        path, least = aligned_empty((lines, *cost.shape[2:])), np.empty(lines, np.float32)
        _aggregate[lanes](cost, guide, path, least, step, jump, 1 / edge, across, out)


def cheapest(
    cost: np.ndarray,  # (H, W, N) float32
    # (H, W) float32: number of the hypothesis with its fraction, from 0 to count − 1; the first of
    # equals
    out: np.ndarray,
    *,
    count: int,  # number of hypotheses among the N places; at least 2
) -> None:
    """Find the hypothesis of least cost, refined by a parabola through three costs."""
    check_array(cost, cost.shape, "cost")
    check_array(out, cost.shape[:2], "out", aligned=False)
    if not 2 <= count <= cost.shape[2]:
        raise ValueError(f"count is {count}: expected 2 to {cost.shape[2]}")
    _cheapest(cost, count, out)


@Kernel
def _cheapest(
    cost: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, N)
    count: ti.i32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        best, least = 0, cost[y, x, 0]
        for n in range(1, count):
            here = cost[y, x, n]
            if here < least:
                best, least = n, here
        offset = 0.0
        if best > 0 and best < count - 1:
            below, above = cost[y, x, best - 1], cost[y, x, best + 1]
            bend = ti.max(below + above - 2.0 * least, LEAST_BEND)
            offset = ti.max(-0.5, ti.min(0.5 * (below - above) / bend, 0.5))
        out[y, x] = best + offset


@lane_kernel
def _aggregate(
    cost: LaneArray(3),  # (H, W, M)
    guide: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    path: LaneArray(2),  # (lines, M): L of the previous pixel
    least: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (lines,): its minimum
    step: ti.f32,
    jump: ti.f32,
    inverse_edge: ti.f32,
    across: ti.template(),
    out: LaneArray(3),  # (H, W, M)
):
    """Sum along rows, writing `out`, or along columns, adding to `out`."""
    lines = path.shape[0]
    if ti.static(lane_count(cost) == 1):  # on a GPU: one thread for each line
        for line in range(lines):
            _follow(cost, guide, path, least, step, jump, inverse_edge, across, out, line, line + 1)
    else:
        together = ti.static(1 if across else COLUMNS)
        for task in range(CHUNK * ((lines + together - 1) // together)):
            if task % CHUNK == 0:
                first = task // CHUNK * together
                end = ti.min(first + together, lines)
                _follow(cost, guide, path, least, step, jump, inverse_edge, across, out, first, end)


@ti.func
def _follow(
    cost: ti.template(),
    guide: ti.template(),
    path: ti.template(),
    least: ti.template(),
    step,
    jump,
    inverse_edge,
    across: ti.template(),
    out: ti.template(),
    first,
    end,
):
    """Sum along lines `first` to `end` − 1 of the image, forward and then backward."""
    count = cost.shape[2]
    lanes = ti.static(lane_count(cost))
    length = cost.shape[1] if ti.static(across) else cost.shape[0]
    for way in range(2):
        adds = way == 1 or ti.static(not across)
        for line in range(first, end):
            least[line] = 0.0
            for m in range(count):
                path[line, m] = 0.0 * cost[0, 0, m]
        for i in range(length):
            at = i if way == 0 else length - 1 - i
            before_at = ti.max(0, ti.min(at - 1 + 2 * way, length - 1))
            for line in range(first, end):
                y = line if ti.static(across) else at
                x = at if ti.static(across) else line
                apart = guide[y, x] - (
                    guide[y, before_at] if ti.static(across) else guide[before_at, x]
                )
                apart = ti.max(apart, 0.0 - apart)
                lowest = least[line]
                leap = lowest + ti.max(step, jump / (1.0 + inverse_edge * apart))
                before = 0.0 * cost[y, x, 0] + FORBIDDEN
                here = path[line, 0]
                smallest = 0.0 * here + 2.0 * FORBIDDEN
                for m in range(count):
                    after = 0.0 * here + FORBIDDEN
                    if m + 1 < count:
                        after = path[line, m + 1]
                    near = ti.min(
                        _shifted_up(before, here, lanes), _shifted_down(here, after, lanes)
                    )
                    best = ti.min(ti.min(here, near + step), leap)
                    value = cost[y, x, m] + best - lowest
                    path[line, m] = value
                    if adds:
                        out[y, x, m] = out[y, x, m] + value  # not +=, which would be atomic
                    else:
                        out[y, x, m] = value
                    smallest = ti.min(smallest, value)
                    before, here = here, after
                least[line] = _least(smallest, lanes)


@ti.func
def _shifted_up(before, here, lanes: ti.template()):
    """Return the values of the previous hypothesis for each lane of `here`."""
    result = before
    if ti.static(lanes > 1):
        result = here
        for lane in ti.static(range(1, lanes)):
            result[lane] = here[lane - 1]
        result[0] = before[lanes - 1]
    return result


@ti.func
def _shifted_down(here, after, lanes: ti.template()):
    """Return the values of the next hypothesis for each lane of `here`."""
    result = after
    if ti.static(lanes > 1):
        result = here
        for lane in ti.static(range(lanes - 1)):
            result[lane] = here[lane + 1]
        result[lanes - 1] = after[0]
    return result


@ti.func
def _least(value, lanes: ti.template()):
    """Return the smallest value of all lanes."""
    result = 0.0
    if ti.static(lanes > 1):
        result = value[0]
        for lane in ti.static(range(1, lanes)):
            result = ti.min(result, value[lane])
    else:
        result = value
    return result
