"""Small symmetric positive definite systems, unrolled while a kernel is being compiled.

These are plain Python functions of Taichi expressions. Inside ``ti.static(...)`` they generate
straight-line code for one pixel (or one vector of lanes). Matrices and vectors are Python lists.
"""

from collections.abc import Iterable
from typing import Any

import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.model import MIN_PIVOT

PIVOT_FLOOR = 1e-6  # share of the diagonal entry, about ten float32 roundings
# smallest ratio of the diagonal D to the matrix J in `woodbury_solve`: with a smaller D, rounding
# dominates the closed form
DATA_FLOOR = 1e-6


def cholesky_solve(
    matrix: list[list],  # symmetric; only the lower triangle is read
    rhs: list,
) -> list:  # x; if a pivot was below its floor, the solution for a slightly larger matrix
    """Solve ``matrix · x = rhs`` by square-root-free Cholesky (L D Lᵀ) with floored pivots."""
    n = len(rhs)
    lower: list[list[Any]] = [[None] * n for _ in range(n)]
    inverse_pivot: list[Any] = [None] * n
    for j in range(n):
        scaled: list[Any] = [None] * n  # row j of L D
        pivot = matrix[j][j]
        for k in range(j):
            scaled[k] = lower[j][k]
            lower[j][k] = bind(scaled[k] * inverse_pivot[k])
            pivot = pivot - scaled[k] * lower[j][k]
        floor = matrix[j][j] * PIVOT_FLOOR + MIN_PIVOT
        inverse_pivot[j] = bind(1.0 / ti.max(pivot, floor))
        for i in range(j + 1, n):
            entry = matrix[i][j]
            for k in range(j):
                entry = entry - lower[i][k] * lower[j][k]
            lower[i][j] = bind(entry)  # entry of L D; in pass j = i it is divided by the pivot
    x: list[Any] = [None] * n
    for i in range(n):
        entry = rhs[i]
        for k in range(i):
            entry = entry - lower[i][k] * x[k]
        x[i] = bind(entry)
    for i in reversed(range(n)):
        entry = x[i] * inverse_pivot[i]
        for k in range(i + 1, n):
            entry = entry - lower[k][i] * x[k]
        x[i] = bind(entry)
    return x


def woodbury_solve(
    # inverse, rhs: the diagonal of D⁻¹, and the right-hand side
    inverse: list,
    columns: list,  # columns of G
    tensor: list,  # (J11, J12, J22)
    rhs: list,
) -> list:
    """Solve ``(D + Gᵀ J G) x = rhs``, D diagonal, through a 2×2 system (Woodbury).

    With M = G D⁻¹ Gᵀ, x = D⁻¹(rhs − Gᵀ K G D⁻¹ rhs), where

        K = (I + J M)⁻¹ J = (J + det J · adj M) / (1 + tr(J M) + det J · det M).

    For grey images and three unknowns, the translation, this is eq. 18 of the paper that
    docs/method.md cites (its third line has s1 in place of s3). The denominator is at least 1, so
    only D needs a floor: it must be at least `DATA_FLOOR` times J. For a J of rank 1, rounding
    makes det J differ from 0. The error of x is then up to ‖J M‖ rounding errors.
    """
    j11, j12, j22 = tensor
    m11 = bind(_sum(a * a * d for (a, _), d in zip(columns, inverse, strict=True)))
    m12 = bind(_sum(a * b * d for (a, b), d in zip(columns, inverse, strict=True)))
    m22 = bind(_sum(b * b * d for (_, b), d in zip(columns, inverse, strict=True)))
    det_j = bind(ti.max(j11 * j22 - j12 * j12, 0.0))
    det_m = bind(ti.max(m11 * m22 - m12 * m12, 0.0))
    trace = bind(j11 * m11 + 2.0 * j12 * m12 + j22 * m22)
    scale = bind(1.0 / (1.0 + ti.max(trace, 0.0) + det_j * det_m))
    k11 = bind((j11 + det_j * m22) * scale)
    k12 = bind((j12 - det_j * m12) * scale)
    k22 = bind((j22 + det_j * m11) * scale)
    y = [bind(entry * d) for entry, d in zip(rhs, inverse, strict=True)]
    u = bind(_sum(a * entry for (a, _), entry in zip(columns, y, strict=True)))
    v = bind(_sum(b * entry for (_, b), entry in zip(columns, y, strict=True)))
    q1 = bind(k11 * u + k12 * v)
    q2 = bind(k12 * u + k22 * v)
    return [
        bind(entry - d * (a * q1 + b * q2))
        for entry, d, (a, b) in zip(y, inverse, columns, strict=True)
    ]


def _sum(terms: Iterable) -> Any:
    total = None
    for term in terms:
        total = term if total is None else total + term
    return total
