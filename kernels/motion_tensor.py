"""The data term as a motion tensor: all that the solver needs to know of the images."""

import taichi as ti

from tisfm.kernels.lanes import LaneArray, LaneGrid, lane_kernel


def brightness_tensor(grid: LaneGrid, derivatives, flow, mask, out) -> None:
    """Write the tensor of the brightness constraint, linearised about a flow.

    With frame 1 warped by (u₀, v₀), the constraint I_t + ∇I·(u − u₀, v − v₀) = 0 squared is
    (u,v) J (u,v)ᵀ + 2 jᵀ(u,v) + J_tt in the whole flow (u, v), with c = I_t − ∇I·(u₀, v₀),
    J = ∇I ∇Iᵀ, j = c ∇I and J_tt = c². With (u₀, v₀) = 0 it is the paper's eq. 4.

    Parameters
    ----------
    grid : LaneGrid
    derivatives : lane array, 3 components
        I_x, I_y, I_t.
    flow : lane array, 2 components
        (u₀, v₀), px/frame.
    mask : lane array, 1 component
        Weight of the constraint at each pixel; 0 outside the image.
    out : lane array, 6 components
        J11, J12, J22, j1, j2, J_tt.
    """
    grid.check(derivatives, 3, "derivatives")
    grid.check(flow, 2, "flow")
    grid.check(mask, 1, "mask")
    grid.check(out, 6, "out")
    _brightness_tensor[grid.lanes](derivatives, flow, mask, out)


@lane_kernel
def _brightness_tensor(
    derivatives: LaneArray(3),  # (3, H+2, S+2)
    flow: LaneArray(3),  # (2, H+2, S+2)
    mask: LaneArray(3),  # (1, H+2, S+2)
    out: LaneArray(3),  # (6, H+2, S+2)
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        weight = mask[0, y, s]
        ix, iy = derivatives[0, y, s], derivatives[1, y, s]
        c = derivatives[2, y, s] - ix * flow[0, y, s] - iy * flow[1, y, s]
        out[0, y, s] = weight * ix * ix
        out[1, y, s] = weight * ix * iy
        out[2, y, s] = weight * iy * iy
        out[3, y, s] = weight * c * ix
        out[4, y, s] = weight * c * iy
        out[5, y, s] = weight * c * c
