"""The motion model (eq. 2): image motion as a linear function of ρ̂, unrolled at compile time.

The number of components determines the model: 6 for rigid motion (τ, ω), 3 for translation (τ),
2 for the image motion itself (G = identity, for Horn and Schunck), 1 for image motion along a known
line (G = (1, 0)ᵀ, see `tisfm.kernels.rigid.epipolar`).
"""

from typing import Any

from tisfm.kernels.layout.internals import bind


def motion_columns(components: int, x: Any, y: Any) -> list[tuple[Any, Any]]:
    """Return the columns of G at normalised coordinates (x, y), as `components` pairs.

    (u, v)ᵀ = G ρ̂, with ρ̂ = f·(τ1, τ2, τ3, ω1, ω2, ω3) in px/frame and x = x_px/f.
    """
    if components == 1:
        return [(1.0, 0.0)]
    if components == 2:
        return [(1.0, 0.0), (0.0, 1.0)]
    translation: list[tuple[Any, Any]] = [(1.0, 0.0), (0.0, 1.0), (0.0 - x, 0.0 - y)]
    if components == 3:
        return translation
    xy = bind(x * y)
    return [*translation, (0.0 - xy, bind(-1.0 - y * y)), (bind(1.0 + x * x), xy), (0.0 - y, x)]


def flow_of(columns: list, rho: list) -> tuple[Any, Any]:
    """Return (u, v) = G ρ̂ (eq. 25)."""
    u: Any = 0.0
    v: Any = 0.0
    for (a, b), component in zip(columns, rho, strict=True):
        u = u + a * component
        v = v + b * component
    return bind(u), bind(v)
