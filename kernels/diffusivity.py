"""The auxiliary field b of the half-quadratic algorithm (eq. 10, 14)."""

import taichi as ti

from tisfm.kernels.lanes import LaneArray, LaneGrid, lane_kernel, refresh_halo


def edge_weights(grid: LaneGrid, rho, open_edges, out, *, contrast: float) -> None:
    """Compute b = 1/√(1 + (Δρ̂_k/δ)²) on every edge, for each component.

    Parameters
    ----------
    grid : LaneGrid
    rho : lane array, n components
        ρ̂, px/frame.
    open_edges : column table
        1 where a pixel has an eastern neighbour (`LaneGrid.open_edges`).
    out : lane array, 2n components
        n eastern edges, then n southern ones; 0 across the border (Neumann).
    contrast : float
        δ, px/frame; infinite for b = 1 (quadratic smoothness).
    """
    components = rho.shape[0]
    grid.check(rho, components, "rho")
    grid.check_columns(open_edges, "open_edges")
    grid.check(out, 2 * components, "out")
    if not contrast > 0:
        raise ValueError(f"contrast is {contrast}: expected a positive value, in px/frame")
    _edge_weights[grid.lanes](rho, open_edges, 1.0 / contrast, components, out)


@lane_kernel
def _edge_weights(
    rho: LaneArray(3),  # (n, H+2, S+2)
    open_edges: LaneArray(1),  # (S+2,)
    inverse_contrast: ti.f32,
    n: ti.template(),
    out: LaneArray(3),  # (2n, H+2, S+2)
):
    height = rho.shape[1] - 2
    strip = rho.shape[2] - 2
    for row, position in ti.ndrange(height, strip):
        y, s = row + 1, position + 1
        open_south = ti.select(row < height - 1, 1.0, 0.0)
        for k in ti.static(range(n)):
            east = inverse_contrast * (rho[k, y, s + 1] - rho[k, y, s])
            south = inverse_contrast * (rho[k, y + 1, s] - rho[k, y, s])
            out[k, y, s] = open_edges[s] / ti.sqrt(1.0 + east * east)
            out[n + k, y, s] = open_south / ti.sqrt(1.0 + south * south)
    # The western weight of a strip's first column is the eastern one of its neighbour's last.
    for k, row in ti.ndrange(n, height):
        refresh_halo(out, k, row + 1)
