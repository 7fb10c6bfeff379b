"""The auxiliary field b of the half-quadratic algorithm (eq. 10, 14)."""

import numpy as np
import taichi as ti

from tisfm.kernels.lanes import LaneArray, LaneGrid, lane_count, lane_kernel, refresh_halo


def edge_weights(
    grid: LaneGrid, rho, edges, out, *, contrast: float, stiffness=None, joint: bool = False
) -> None:
    """Compute the weight s_k·g·b of every edge, for each component.

    b = 1/√(1 + s_k(Δρ̂_k/δ)²), or, joint, 1/√(1 + Σ_k s_k(Δρ̂_k/δ)²) for all components alike.

    Parameters
    ----------
    grid : LaneGrid
    rho : lane array, n components
        ρ̂, px/frame.
    edges : lane array, 2 components
        g of the eastern and the southern edge; 0 across the border (Neumann).
        `LaneGrid.open_edges` is 1 elsewhere.
    out : lane array, 2n components
        n eastern edges, then n southern ones.
    contrast : float
        δ, px/frame; infinite for b = 1 (quadratic smoothness).
    stiffness : sequence of n floats, optional
        s_k, by default 1.
    joint : bool
        Whether an edge is one for all components.
    """
    components = rho.shape[0]
    grid.check(rho, components, "rho")
    grid.check(edges, 2, "edges")
    grid.check(out, 2 * components, "out")
    if not contrast > 0:
        raise ValueError(f"contrast is {contrast}: expected a positive value, in px/frame")
    _edge_weights[grid.lanes](
        rho, edges, stiffness_table(stiffness, components), 1.0 / contrast, components, joint, out
    )


def stiffness_table(stiffness, components: int) -> np.ndarray:
    """Return s_k as a kernel takes it: (n,) float32."""
    values = np.ones(components) if stiffness is None else np.asarray(stiffness, np.float64)
    if values.shape != (components,) or not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(f"stiffness is {stiffness}: expected {components} positive numbers")
    return values.astype(np.float32)


@lane_kernel
def _edge_weights(
    rho: LaneArray(3),  # (n, H+2, S+2)
    edges: LaneArray(3),  # (2, H+2, S+2)
    stiffness: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    inverse_contrast: ti.f32,
    n: ti.template(),
    joint: ti.template(),
    out: LaneArray(3),  # (2n, H+2, S+2)
):
    height = rho.shape[1] - 2
    strip = rho.shape[2] - 2
    squared = inverse_contrast * inverse_contrast
    for row, position in ti.ndrange(height, strip):
        y, s = row + 1, position + 1
        open_east, open_south = edges[0, y, s], edges[1, y, s]
        if ti.static(joint):
            east, south = 1.0 + 0.0 * open_east, 1.0 + 0.0 * open_east
            for k in ti.static(range(n)):
                to_east = rho[k, y, s + 1] - rho[k, y, s]
                to_south = rho[k, y + 1, s] - rho[k, y, s]
                east += squared * stiffness[k] * to_east * to_east
                south += squared * stiffness[k] * to_south * to_south
            for k in ti.static(range(n)):
                out[k, y, s] = stiffness[k] * open_east / ti.sqrt(east)
                out[n + k, y, s] = stiffness[k] * open_south / ti.sqrt(south)
        else:
            for k in ti.static(range(n)):
                scale = squared * stiffness[k]
                to_east = rho[k, y, s + 1] - rho[k, y, s]
                to_south = rho[k, y + 1, s] - rho[k, y, s]
                east = ti.sqrt(1.0 + scale * to_east * to_east)
                south = ti.sqrt(1.0 + scale * to_south * to_south)
                out[k, y, s] = stiffness[k] * open_east / east
                out[n + k, y, s] = stiffness[k] * open_south / south
    # The western weight of a strip's first column is the eastern one of its neighbour's last.
    if ti.static(lane_count(out) > 1):
        for k, row in ti.ndrange(n, height):
            refresh_halo(out, k, row + 1)
