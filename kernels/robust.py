"""The robust data term: tensors weighted by how well their constraints are met.

A term with tensor J_i and weight m_i contributes m_i ψ(q_i/m_i), where q_i is its quadratic form
at the current flow and ψ(q) = 2ε²(√(1 + q/ε²) − 1) (Charbonnier), written 2q/(1 + √(1 + q/ε²)).
Its half-quadratic form is w q + m ε²(w + 1/w − 2), least for w = 1/√(1 + q/(m ε²)).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.lanes import LaneArray, LaneGrid, SumArray, lane_count, lane_kernel
from tisfm.kernels.reductions import BLOCK, add_blocks, block_sums, store_sum
from tisfm.kernels.rigid_motion import flow_of, motion_columns


def robust_tensor(grid: LaneGrid, terms, x_hat, y_hat, rho, out, *, scales) -> None:
    """Weight the terms for the current ρ̂ and add them up.

    Parameters
    ----------
    grid : LaneGrid
    terms : lane array, 6 components for each of 1 or 2 terms
        Motion tensors.
    x_hat : column table
    y_hat : (H + 2,) float32
    rho : lane array, n components
    out : lane array, 6 components
        Σ w_i J_i; its J_tt includes the penalties m_i ε²(w_i + 1/w_i − 2), so that its quadratic
        form is the half-quadratic data term.
    scales : sequence of float
        m_i ε² of each term; infinite for a quadratic one.
    """
    count = check_terms(grid, terms, x_hat, y_hat, rho, scales)
    grid.check(out, 6, "out")
    _robust_tensor[grid.lanes](
        terms, x_hat, y_hat, rho, *finite_scales(scales), rho.shape[0], count, out
    )


def robust_energy(grid: LaneGrid, terms, x_hat, y_hat, rho, *, scales) -> float:
    """Return the data term Σ m_i ψ(q_i/m_i), summed over pixels and terms.

    Parameters are those of `robust_tensor`.
    """
    count = check_terms(grid, terms, x_hat, y_hat, rho, scales)
    partial = block_sums(grid, 1)
    inverse = finite_scales(scales)[::2]
    _robust_energy[grid.lanes](terms, x_hat, y_hat, rho, *inverse, rho.shape[0], count, partial)
    return float(add_blocks(partial)[0])


def check_terms(grid, terms, x_hat, y_hat, rho, scales) -> int:
    """Raise unless the arguments are what `robust_tensor` says; return the number of terms."""
    count = len(scales)
    if count not in (1, 2):
        raise ValueError(f"scales has {count} values: expected 1 or 2")
    if not all(scale > 0 for scale in scales):
        raise ValueError(f"scales is {tuple(scales)}: expected positive values")
    grid.check(terms, 6 * count, "terms")
    grid.check(rho, rho.shape[0], "rho")
    grid.check_columns(x_hat, "x_hat")
    grid.check_rows(y_hat, "y_hat")
    return count


def finite_scales(scales) -> tuple[float, ...]:
    """Return 1/scale and scale of two terms; 0 and 0 for a quadratic one, w = 1 without penalty."""
    pairs = [(1.0 / s, s) if np.isfinite(s) else (0.0, 0.0) for s in (*scales, np.inf)]
    return (*pairs[0], *pairs[1])


@lane_kernel
def _robust_tensor(
    terms: LaneArray(3),  # (6 or 12, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    rho: LaneArray(3),  # (n, H+2, S+2)
    inverse0: ti.f32,
    scale0: ti.f32,
    inverse1: ti.f32,
    scale1: ti.f32,
    n: ti.template(),
    count: ti.template(),
    out: LaneArray(3),  # (6, H+2, S+2)
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
        u, v = ti.static(flow_of(columns, [rho[k, y, s] for k in range(n)]))
        w0 = 1.0 / ti.sqrt(1.0 + inverse0 * quadratic(terms, 0, y, s, u, v))
        penalty = scale0 * (1.0 - w0) * (1.0 - w0) / w0
        if ti.static(count == 1):
            for k in ti.static(range(5)):
                out[k, y, s] = w0 * terms[k, y, s]
            out[5, y, s] = w0 * terms[5, y, s] + penalty
        else:
            w1 = 1.0 / ti.sqrt(1.0 + inverse1 * quadratic(terms, 6, y, s, u, v))
            penalty = penalty + scale1 * (1.0 - w1) * (1.0 - w1) / w1
            for k in ti.static(range(5)):
                out[k, y, s] = w0 * terms[k, y, s] + w1 * terms[6 + k, y, s]
            out[5, y, s] = w0 * terms[5, y, s] + w1 * terms[11, y, s] + penalty


@lane_kernel
def _robust_energy(
    terms: LaneArray(3),  # (6 or 12, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    rho: LaneArray(3),  # (n, H+2, S+2)
    inverse0: ti.f32,
    inverse1: ti.f32,
    n: ti.template(),
    count: ti.template(),
    partial: SumArray(3),  # (H, blocks, 1)
):
    height, strip = rho.shape[1] - 2, rho.shape[2] - 2
    blocks = partial.shape[1]
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        y = row + 1
        total = 0.0 * x_hat[1]
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            s = position + 1
            columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
            u, v = ti.static(flow_of(columns, [rho[k, y, s] for k in range(n)]))
            q0 = quadratic(terms, 0, y, s, u, v)
            total += 2.0 * q0 / (1.0 + ti.sqrt(1.0 + inverse0 * q0))
            if ti.static(count == 2):
                q1 = quadratic(terms, 6, y, s, u, v)
                total += 2.0 * q1 / (1.0 + ti.sqrt(1.0 + inverse1 * q1))
        store_sum(partial, row, block, 0, total, ti.static(lane_count(rho)))


@ti.func
def quadratic(terms: ti.template(), first: ti.template(), y, s, u, v):
    """Return the quadratic form of the term that begins at component `first`, at least 0."""
    j12, j1 = terms[first + 1, y, s], terms[first + 3, y, s]
    value = u * (terms[first, y, s] * u + 2.0 * (j12 * v + j1))
    value += v * (terms[first + 2, y, s] * v + 2.0 * terms[first + 4, y, s])
    return ti.max(value + terms[first + 5, y, s], 0.0)  # a square, but for its rounding
