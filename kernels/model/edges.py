"""Weights of the smoothness term on edges, where an edge joins two neighbouring pixels.

The auxiliary field b (eq. 10, 14) of the half-quadratic algorithm has one value per edge and
component, b = 1/√(1 + s_k(Δρ̂_k/δ)²), or, if joint, one value per edge for all components,
1/√(1 + Σ_k s_k(Δρ̂_k/δ)²). Weights are g·b. They are stored in a lane array of 2n components, n for
eastern edges and then n for southern edges, or, if joint, of 2 components, eastern and southern.
The kernels multiply them by α_k = α s_k.
"""

from collections.abc import Sequence

import numpy as np


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


def spread(values: list, components: int) -> list:
    """Return a list of n values of an edge, from a list of n or of 1, while compiling."""
    return values if len(values) == components else values * components
