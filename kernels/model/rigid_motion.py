"""The motion model (eq. 2): image motion as a linear function of ρ̂, unrolled at compile time.

Equations are numbered as in the paper that docs/method.md cites; ρ̂ are the unknowns of a pixel.

The number of components determines the model: 6 for rigid motion (τ, ω), 3 for translation (τ),
2 for the image motion itself (G = identity, for Horn and Schunck), 1 for image motion along a known
line (G = (1, 0)ᵀ, see `tisfm.kernels.rigid.epipolar`).

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from typing import Any

import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation


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


@operation
def flow(
    grid: LaneGrid,
    rho: LaneData,  # lane array, n components: ρ̂, px/frame
    # x_hat, y_hat: normalised coordinates of columns, as from `LaneGrid.columns`, and of rows,
    # (H + 2,) float32
    x_hat: LaneData,
    y_hat: LaneData,
    out: LaneData,  # lane array, 2 components: (u, v), px/frame
) -> Launch:
    """Compute (u, v)ᵀ = G ρ̂."""
    grid.check(rho, rho.shape[0], "rho")
    grid.check_columns(x_hat, "x_hat")
    grid.check_rows(y_hat, "y_hat")
    grid.check(out, 2, "out")
    return _flow[grid.lanes].bind(rho, x_hat, y_hat, rho.shape[0], grid.is_serial, out)


@lane_kernel
def _flow(
    rho: LaneArray(3),  # (n, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    n: ti.template(),
    is_serial: ti.template(),
    out: LaneArray(3),  # (2, H+2, S+2)
):
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
        u, v = ti.static(flow_of(columns, [rho[k, y, s] for k in range(n)]))
        out[0, y, s] = u
        out[1, y, s] = v
