"""The robust data term: tensors weighted by how well their constraints are met.

A term with tensor J_i and weight m_i contributes m_i ψ(q_i/m_i), where q_i is its quadratic form
at the current flow and ψ(q) = 2ε²(√(1 + q/ε²) − 1) (Charbonnier), written 2q/(1 + √(1 + q/ε²)).
Its half-quadratic form is w q + m ε²(w + 1/w − 2), least for w = 1/√(1 + q/(m ε²)).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.small_spd import bind


def check_terms(grid, terms, x_hat, y_hat, rho, scales) -> int:
    """Raise unless terms, tables and ρ̂ are of the grid; return the number of terms."""
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


@ti.func
def quadratic(terms: ti.template(), first: ti.template(), y, s, u, v):
    """Return the quadratic form of the term that begins at component `first`, at least 0."""
    term = ti.static([bind(terms[first + k, y, s]) for k in range(6)])
    return form(term, u, v)


@ti.func
def form(term: ti.template(), u, v):
    """Return the quadratic form of a list of six, at least 0: a square, but for its rounding."""
    value = u * (term[0] * u + 2.0 * (term[1] * v + term[3]))
    value += v * (term[2] * v + 2.0 * term[4]) + term[5]
    return ti.max(value, 0.0)
