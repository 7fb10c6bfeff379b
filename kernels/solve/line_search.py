"""Minimum of the energy in the plane of two directions: one step of conjugate gradients.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    LaneArray,
    LaneData,
    LaneGrid,
    SumArray,
    lane_count,
    lane_kernel,
    refresh_halo,
)
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.layout.reductions import BLOCK, add_blocks, block_sums, store_sum
from tisfm.kernels.model.rigid_motion import flow_of, motion_columns

MIN_INDEPENDENCE = 1e-5  # squared sine of the angle between directions, in the norm of the energy
# Accuracy of an entry of the vector, as a share of the sum of the absolute values of its terms:
# each term has a few rounding errors of float32.
ROUNDING = 64 * 2.0**-24


def line_search(
    grid: LaneGrid,
    # arrays of a `tisfm.kernels.solve.linear_system.LinearSystem`, which has checked them
    arrays: tuple[LaneData, ...],
    # rho, previous, step: lane arrays, n components: modified in place, halo included: `rho` and
    # `previous` become the minimum, `step` becomes the move to it
    rho: LaneData,
    previous: LaneData,
    step: LaneData,
) -> None:
    """Move to the minimum of the energy over previous + p (rho − previous) + q step.

    If the slope along the correction is only rounding error, as at the solution, p = 1 and q = 0:
    the computed p would be the ratio of two rounding errors, which can have any size.
    """
    subtract(grid, previous, rho)
    move_to_minimum(
        grid, *minimise_plane(*plane_energy(grid, arrays, rho, previous, step)), rho, previous, step
    )


def plane_energy(
    grid: LaneGrid,
    arrays: tuple[LaneData, ...],
    correction: LaneData,
    previous: LaneData,
    step: LaneData,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the quadratic energy of previous + p correction + q step, as a function of p and q.

    The function returns a matrix and a vector, (2, 2) and (2,) float64: the energy changes by zᵀ
    matrix z + 2 zᵀ vector, with z = (p, q). An entry of the vector that is only rounding error is
    set to 0.
    """
    partial = block_sums(grid, 7)
    weight_count = arrays[1].shape[0] // 2
    _plane_energy[grid.lanes](
        *arrays, correction, previous, step, previous.shape[0], weight_count, partial
    )
    return quadratic_of_sums(partial)


def quadratic_of_sums(partial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix and vector of `plane_energy` from the 7 sums of its kernel."""
    a, b, c, *slopes = add_blocks(partial)
    vector, magnitudes = np.array(slopes[:2]), np.array(slopes[2:])
    vector[np.abs(vector) <= ROUNDING * magnitudes] = 0
    return np.array([[a, b], [b, c]]), vector


def minimise_plane(matrix: np.ndarray, vector: np.ndarray) -> tuple[float, float]:
    """Return z = (p, q) of least zᵀ matrix z + 2 zᵀ vector; q is 0 for dependent directions.

    If the first entry of the vector is 0, it does not determine p, and the result is (1, 0).
    """
    (a, b), (_, c) = matrix
    if not a > 0:
        return 0.0, 0.0
    if vector[0] == 0:
        return 1.0, 0.0
    determinant = a * c - b * b
    if determinant > MIN_INDEPENDENCE * a * c:
        p, q = np.linalg.solve(matrix, -vector)
        return float(p), float(q)
    return float(-vector[0] / a), 0.0


@lane_kernel
def _plane_energy(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    alpha: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    correction: LaneArray(3),  # (n, H+2, S+2)
    previous: LaneArray(3),  # (n, H+2, S+2)
    step: LaneArray(3),  # (n, H+2, S+2)
    n: ti.template(),
    weight_count: ti.template(),  # weights of an edge: n, or 1
    partial: SumArray(3),  # (H, blocks, 7)
):
    height, strip = previous.shape[1] - 2, previous.shape[2] - 2
    blocks = partial.shape[1]
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        y = row + 1
        sums = ti.static([bind(0.0 * x_hat[1]) for _ in range(7)])
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            s = position + 1
            columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
            j11, j12, j22 = tensor[0, y, s], tensor[1, y, s], tensor[2, y, s]
            u, v = ti.static(flow_of(columns, [previous[k, y, s] for k in range(n)]))
            a, b = ti.static(flow_of(columns, [correction[k, y, s] for k in range(n)]))
            c, d = ti.static(flow_of(columns, [step[k, y, s] for k in range(n)]))
            j1, j2 = tensor[3, y, s], tensor[4, y, s]
            gu = j11 * u + j12 * v + j1
            gv = j12 * u + j22 * v + j2
            size_u = size_of(j11 * u) + size_of(j12 * v) + size_of(j1)
            size_v = size_of(j12 * u) + size_of(j22 * v) + size_of(j2)
            ja, jb = j11 * a + j12 * b, j12 * a + j22 * b
            sums[0] += ja * a + jb * b
            sums[1] += ja * c + jb * d
            sums[2] += (j11 * c + j12 * d) * c + (j12 * c + j22 * d) * d
            sums[3] += gu * a + gv * b
            sums[4] += gu * c + gv * d
            sums[5] += size_u * size_of(a) + size_v * size_of(b)
            sums[6] += size_u * size_of(c) + size_v * size_of(d)
            for side in ti.static(range(2)):  # east, south
                for k in ti.static(range(n)):
                    weight = alpha[k] * weights[weight_count * side + k % weight_count, y, s]
                    previous_step = previous[k, y + side, s + 1 - side] - previous[k, y, s]
                    correction_step = correction[k, y + side, s + 1 - side] - correction[k, y, s]
                    last_step = step[k, y + side, s + 1 - side] - step[k, y, s]
                    sums[0] += weight * correction_step * correction_step
                    sums[1] += weight * correction_step * last_step
                    sums[2] += weight * last_step * last_step
                    sums[3] += weight * previous_step * correction_step
                    sums[4] += weight * previous_step * last_step
                    sums[5] += weight * size_of(previous_step) * size_of(correction_step)
                    sums[6] += weight * size_of(previous_step) * size_of(last_step)
        for term in ti.static(range(7)):
            store_sum(partial, row, block, term, sums[term], ti.static(lane_count(previous)))


@ti.func
def size_of(value):
    """Return |value|, in a form that works for vectors of lanes."""
    return ti.max(value, 0.0 - value)


def move_to_minimum(
    grid: LaneGrid, p: float, q: float, rho: LaneData, previous: LaneData, step: LaneData
) -> None:
    """Move from `previous` by p rho + q step, with `rho` a correction; see `line_search`."""
    _move_to_minimum[grid.lanes](p, q, rho.shape[0], rho, previous, step)


@operation
def subtract(grid: LaneGrid, previous: LaneData, rho: LaneData) -> Launch:
    """Replace a corrected `rho` by the correction, in place, halo included.

    The difference must be stored in memory. As an expression inside `_plane_energy` it would be
    reordered, with the rounding errors of the unknowns, which are larger than the correction's.
    """
    return _subtract[grid.lanes].bind(previous, rho)


@lane_kernel
def _subtract(
    previous: LaneArray(3),  # (n, H+2, S+2)
    rho: LaneArray(3),  # (n, H+2, S+2), in place
):
    for k, y, s in ti.ndrange(rho.shape[0], rho.shape[1], rho.shape[2]):
        rho[k, y, s] = rho[k, y, s] - previous[k, y, s]


@lane_kernel
def _move_to_minimum(
    p: ti.f32,
    q: ti.f32,
    n: ti.template(),
    rho: LaneArray(3),  # (n, H+2, S+2), in place
    previous: LaneArray(3),  # (n, H+2, S+2), in place
    step: LaneArray(3),  # (n, H+2, S+2), in place
):
    height, strip = rho.shape[1] - 2, rho.shape[2] - 2
    for row, position in ti.ndrange(height, strip):
        y, s = row + 1, position + 1
        for k in ti.static(range(n)):
            start = previous[k, y, s]
            move = p * rho[k, y, s] + q * step[k, y, s]
            rho[k, y, s] = start + move
            previous[k, y, s] = start + move
            step[k, y, s] = move
    for k, row in ti.ndrange(n, height):
        refresh_halo(rho, k, row + 1)
        refresh_halo(previous, k, row + 1)
        refresh_halo(step, k, row + 1)
