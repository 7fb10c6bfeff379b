"""Sum of the data terms of several frames, as a function of one inverse depth per pixel.

For flow along the epipolar line of a frame (`tisfm.kernels.rigid.epipolar`), its data term is
A D² + 2 B D + C. These three numbers per pixel are added up over the frames.
"""

import taichi as ti

from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.model.constants import LEAST_DIVISOR


@operation
def add_along(
    grid: LaneGrid,
    tensor: LaneData,  # lane array, 6 components: J11, J12, J22, j1, j2 and J_tt, at `flow`
    # flow, direction: lane arrays, 2 components: (u₀, v₀) and a = ∂(u, v)/∂D, at `inverse_depth`
    flow: LaneData,
    direction: LaneData,
    inverse_depth: LaneData,  # lane array, 1 component: D₀
    weight: LaneData,  # lane array, 1 component: weight of this frame at each pixel
    # lane array, 3 components: A, B and C. The values aᵀJa, aᵀ(J u + j) and uᵀJu + 2 jᵀu + J_tt,
    # times the weight, are added, with u = (u₀, v₀) − D₀ a.
    out: LaneData,
) -> Launch:
    """Restrict the motion tensor of a frame to its epipolar line, and add it to A, B and C."""
    grid.check(tensor, 6, "tensor")
    grid.check(flow, 2, "flow")
    grid.check(direction, 2, "direction")
    grid.check(inverse_depth, 1, "inverse_depth")
    grid.check(weight, 1, "weight")
    grid.check(out, 3, "out")
    return _add_along[grid.lanes].bind(tensor, flow, direction, inverse_depth, weight, out)


@operation
def as_constraint(
    grid: LaneGrid,
    sums: LaneData,  # lane array, 3 components: A, B and C of `add_along`
    out: LaneData,  # lane array, 3 components: (p, 0, c) = (√A, 0, B/√A). The zero is not written.
) -> Launch:
    """Write the constraint p D + c = 0 whose square is A D² + 2 B D up to a constant."""
    grid.check(sums, 3, "sums")
    grid.check(out, 3, "out")
    return _as_constraint[grid.lanes].bind(sums, out)


@lane_kernel
def _add_along(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    flow: LaneArray(3),  # (2, H+2, S+2)
    direction: LaneArray(3),  # (2, H+2, S+2)
    inverse_depth: LaneArray(3),  # (1, H+2, S+2)
    weight: LaneArray(3),  # (1, H+2, S+2)
    out: LaneArray(3),  # (3, H+2, S+2), in place
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        a, b = direction[0, y, s], direction[1, y, s]
        d, share = inverse_depth[0, y, s], weight[0, y, s]
        u, v = flow[0, y, s] - d * a, flow[1, y, s] - d * b
        j11, j12, j22 = tensor[0, y, s], tensor[1, y, s], tensor[2, y, s]
        j1, j2 = tensor[3, y, s], tensor[4, y, s]
        along_u, along_v = j11 * u + j12 * v, j12 * u + j22 * v
        square = (j11 * a + 2.0 * j12 * b) * a + j22 * b * b
        product = (along_u + j1) * a + (along_v + j2) * b
        rest = (along_u + 2.0 * j1) * u + (along_v + 2.0 * j2) * v + tensor[5, y, s]
        out[0, y, s] = out[0, y, s] + share * square
        out[1, y, s] = out[1, y, s] + share * product
        out[2, y, s] = out[2, y, s] + share * rest


@lane_kernel
def _as_constraint(
    sums: LaneArray(3),  # (3, H+2, S+2)
    out: LaneArray(3),  # (3, H+2, S+2)
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        square = ti.max(sums[0, y, s], 0.0)
        out[0, y, s] = ti.sqrt(square)
        out[2, y, s] = sums[1, y, s] / ti.sqrt(ti.max(square, LEAST_DIVISOR))
