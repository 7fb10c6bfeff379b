"""What the regularisation of an edge between two pixels weighs, for each unknown.

The auxiliary field b (eq. 10, 14) of the half-quadratic algorithm has one value per edge and
component, b = 1/√(1 + s_k(Δρ̂_k/δ)²), or, joint, one value per edge for all components alike,
1/√(1 + Σ_k s_k(Δρ̂_k/δ)²). Weights are g·b: a lane array of 2n components, n eastern edges and
then n southern ones, or of 2, an eastern and a southern one. Where every kernel multiplies them
by α_k = α s_k, what is shared need not be stored n times.
"""

from collections.abc import Sequence

import numpy as np


def component_table(values: Sequence[float] | np.ndarray, components: int, name: str) -> np.ndarray:
    """Return one value for each component, as a kernel takes them: (n,) float32.

    Parameters
    ----------
    values : sequence of n floats
        Above 0 and finite.
    components : int
    name : str
        What the error calls them.
    """
    table = np.asarray(values)
    if table.shape != (components,) or not (np.isfinite(table).all() and (table > 0).all()):
        raise ValueError(f"{name} is {values}: expected {components} positive numbers")
    return np.ascontiguousarray(table, np.float32)


def spread(values: list, components: int) -> list:
    """Return what an edge has for each component, from a list of n or of 1, while compiling."""
    return values if len(values) == components else values * components
