"""Robust terms: a constraint or an edge has less weight if its residual is large.

The constraints (p, q, c) of data term i include its weight m_i (`tisfm.kernels.data.constraints`).
Their squares add up to e_i, so e_i/m_i is free of the weight. The term contributes m_i ψ(e_i/m_i)
to the energy, with ψ(e) = 2ε²(√(1 + e/ε²) − 1) (Charbonnier), computed as 2e/(1 + √(1 + e/ε²)). Its
half-quadratic form is w e + m ε²(w + 1/w − 2), with its minimum at w = 1/√(1 + e/(m ε²)).

An edge joins two neighbouring pixels. ρ̂ are the n unknowns of a pixel, Δρ̂_k is the difference of
unknown k along an edge, s_k the stiffness of this unknown, and δ the contrast. The auxiliary field
b has one value per edge and unknown, b = 1/√(1 + s_k(Δρ̂_k/δ)²), or, if joint, one value per edge
for all unknowns, 1/√(1 + Σ_k s_k(Δρ̂_k/δ)²). The weight of an edge is g·b, with g the image-driven
factor. Weights are stored in a lane array of 2n components, n for eastern edges and then n for
southern edges, or, if joint, of 2 components, eastern and southern. The kernels multiply them by
α_k = α s_k, with α the strength of the smoothness.

Python functions here that take Taichi expressions are called inside ``ti.static(...)``: they
generate their arithmetic while a kernel is compiled.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import LaneData, LaneGrid


def check_constraints(grid: LaneGrid, terms: LaneData, scales: Sequence[float]) -> int:
    """Return the number of constraints, 1, 2 or 3; raise unless `scales` has one value per term."""
    if not all(scale > 0 for scale in scales):
        raise ValueError(f"scales is {tuple(scales)}: expected positive values")
    count = int(terms.shape[0]) // 3
    if count not in (1, 2, 3) or len(scales) != len(terms_of(range(count))):
        raise ValueError(
            f"terms has {terms.shape[0]} components and scales {len(scales)} values: expected 3 "
            "or 6 for one term, 9 for two"
        )
    grid.check(terms, 3 * count, "terms")
    return count


def terms_of(constraints: Any) -> list:
    """Return the constraints of each term; of three, the first forms a term, the others another."""
    if len(constraints) < 3:
        return [constraints]
    return [constraints[:1], constraints[1:]]


def scale_pairs(scales: Sequence[float]) -> tuple[float, ...]:
    """Return 1/scale and scale of two terms; 0 and 0 for an infinite scale, where w is 1."""
    pairs = [(1.0 / s, s) if np.isfinite(s) else (0.0, 0.0) for s in (*scales, np.inf)]
    return (*pairs[0], *pairs[1])


def sum_of_squares(constraints: list, u: Any, v: Any) -> Any:
    """Return the sum of the squares of a term's constraints (p, q, c)."""
    total: Any = 0.0
    for p, q, c in constraints:
        distance = bind(p * u + q * v + c)
        total = total + distance * distance
    return bind(total)


def motion_tensor(constraints: list) -> list:
    """Return the motion tensor of a term: Σ p², p q, q², p c, q c, c²."""
    tensor: list[Any] = [0.0] * 6
    for p, q, c in constraints:
        entries = (p * p, p * q, q * q, p * c, q * c, c * c)
        tensor = [total + entry for total, entry in zip(tensor, entries, strict=True)]
    return [bind(entry) for entry in tensor]


def robust_data(terms: list, scales: list, u: Any, v: Any) -> tuple[Any, list]:
    """Return the energy of a pixel's terms at a flow, and the tensor of its half-quadratic form.

    `terms` are lists of constraints, `scales` the pairs of `scale_pairs`. J_tt includes the
    penalty m ε²(w + 1/w − 2), so the quadratic form of the tensor is the half-quadratic energy.
    """
    energy: Any = 0.0
    tensor: list[Any] = [0.0] * 6
    for constraints, (inverse_scale, scale) in zip(terms, scales, strict=False):
        squares = sum_of_squares(constraints, u, v)
        root = bind(ti.sqrt(1.0 + inverse_scale * squares))
        factor = bind(1.0 / (root * (1.0 + root)))  # one division in place of two
        weight = bind((1.0 + root) * factor)
        energy = energy + 2.0 * squares * (root * factor)
        tensor = [
            total + weight * entry
            for total, entry in zip(tensor, motion_tensor(constraints), strict=True)
        ]
        tensor[5] = tensor[5] + scale * (1.0 - weight) * (root - 1.0)  # m ε²(w + 1/w − 2)
    return bind(energy), [bind(entry) for entry in tensor]


def component_table(
    values: Sequence[float] | np.ndarray,  # above 0 and finite
    components: int,
    name: str,  # name of the values in the error
) -> np.ndarray:
    """Return one value for each component as an array for a kernel, (n,) float32."""
    table = np.asarray(values)
    if table.shape != (components,) or not (np.isfinite(table).all() and (table > 0).all()):
        raise ValueError(f"{name} is {values}: expected {components} positive numbers")
    return np.ascontiguousarray(table, np.float32)


def repeat_shared(values: list, components: int) -> list:
    """Return a list of n values of an edge, from a list of n or of 1, while compiling."""
    return values if len(values) == components else values * components
