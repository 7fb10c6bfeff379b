"""Image motion from the unknowns ρ̂ (eq. 25)."""

import taichi as ti

from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.model.rigid_motion import flow_of, motion_columns


@operation
def flow(
    grid: LaneGrid,
    rho: LaneData,  # lane array, n components: ρ̂, px/frame
    x_hat: LaneData,
    y_hat: LaneData,  # (H + 2,) float32
    out: LaneData,  # lane array, 2 components: (u, v), px/frame
) -> Launch:
    """Compute (u, v)ᵀ = G ρ̂."""
    grid.check(rho, rho.shape[0], "rho")
    grid.check_columns(x_hat, "x_hat")
    grid.check_rows(y_hat, "y_hat")
    grid.check(out, 2, "out")
    return _flow[grid.lanes].bind(rho, x_hat, y_hat, rho.shape[0], grid.serial, out)


@lane_kernel
def _flow(
    rho: LaneArray(3),  # (n, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    n: ti.template(),
    serial: ti.template(),
    out: LaneArray(3),  # (2, H+2, S+2)
):
    ti.loop_config(serialize=serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
        u, v = ti.static(flow_of(columns, [rho[k, y, s] for k in range(n)]))
        out[0, y, s] = u
        out[1, y, s] = v
