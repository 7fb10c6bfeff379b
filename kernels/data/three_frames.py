"""Constraints of a frame with its next and its previous frame, joined to one set.

A constraint (p, q, c) is the equation p u + q v + c = 0 for the flow (u, v) of a pixel. A lane
array holds an image as vertical strips of width S (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Sequence

import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.model.robust import check_constraints, robust_data, scale_pairs, terms_of


@operation
def backward_flow(
    grid: LaneGrid,
    # flow, flow_sum: lane arrays, 2 components: flow to the next frame, and sum of the flows to the
    # next and to the previous frame, px/frame
    flow: LaneData,
    flow_sum: LaneData,
    out: LaneData,  # lane array, 2 components: flow_sum − flow
) -> Launch:
    """Write the flow to the previous frame, flow_sum − flow."""
    for array, name in ((flow, "flow"), (flow_sum, "flow_sum"), (out, "out")):
        grid.check(array, 2, name)
    return _backward_flow[grid.lanes].bind(flow, flow_sum, grid.is_serial, out)


@lane_kernel
def _backward_flow(
    flow: LaneArray(3),  # (2, H+2, S+2)
    flow_sum: LaneArray(3),  # (2, H+2, S+2)
    is_serial: ti.template(),
    out: LaneArray(3),  # (2, H+2, S+2)
):
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        for k in ti.static(range(2)):
            out[k, y, s] = flow_sum[k, y, s] - flow[k, y, s]


@operation
def join_constraints(
    grid: LaneGrid,
    # lane array, 3 components for each constraint: (p, q, c) of the previous frame, as constraints
    # on the flow to the next frame: the flow to the previous frame is flow_sum minus this flow
    previous: LaneData,
    # lane array, 2 components: in [0, 1]: visibility of a pixel in the next frame, and in the
    # previous frame
    trust: LaneData,
    # mask, previous_mask: lane arrays, 1 component: masks of the constraints of the next and of the
    # previous frame
    mask: LaneData,
    previous_mask: LaneData,
    # lane array, 2 components: flow at which the robust weights of the tensor are computed,
    # px/frame
    flow: LaneData,
    # m ε² of each data term: its weight and its squared contrast (`tisfm.kernels.model.robust`)
    scales: Sequence[float],
    # lane array, 3 components for each constraint: (p, q, c) of the next frame; overwritten by the
    # joint constraints
    out: LaneData,
    tensor: LaneData,  # lane array, 6 components: Σ w_i J_i with the robust weights at the flow
) -> Launch:
    """Join the constraints of the next frame with those of the previous frame, in place.

    The joint constraint is (a A + b B) / max(1, a + b), with A and B the constraints of the next
    and the previous frame, and the weights a and b trust times mask. Where both frames show a
    pixel, this is the mean of A and B. Both contain the noise of the present frame; the mean
    reduces its effect. Elsewhere this is the constraint of the frame that shows the pixel.
    """
    count = check_constraints(grid, out, scales)
    grid.check(previous, 3 * count, "previous")
    for array, n, name in (
        (trust, 2, "trust"),
        (mask, 1, "mask"),
        (previous_mask, 1, "previous_mask"),
        (flow, 2, "flow"),
        (tensor, 6, "tensor"),
    ):
        grid.check(array, n, name)
    return _join[grid.lanes].bind(
        previous, trust, mask, previous_mask, flow, *scale_pairs(scales), count, grid.is_serial,
        out, tensor,
    )  # fmt: skip


@lane_kernel
def _join(
    previous: LaneArray(3),  # (3 count, H+2, S+2)
    trust: LaneArray(3),  # (2, H+2, S+2)
    mask: LaneArray(3),  # (1, H+2, S+2)
    previous_mask: LaneArray(3),  # (1, H+2, S+2)
    flow: LaneArray(3),  # (2, H+2, S+2)
    inverse_scale0: ti.f32,
    scale0: ti.f32,
    inverse_scale1: ti.f32,
    scale1: ti.f32,
    count: ti.template(),
    is_serial: ti.template(),
    out: LaneArray(3),  # (3 count, H+2, S+2), in place
    tensor: LaneArray(3),  # (6, H+2, S+2)
):
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        next_weight, previous_weight = (
            trust[0, y, s] * mask[0, y, s],
            trust[1, y, s] * previous_mask[0, y, s],
        )
        inverse = 1.0 / ti.max(1.0, next_weight + previous_weight)
        a, b = inverse * next_weight, inverse * previous_weight
        entries = ti.static(
            [bind(a * out[k, y, s] + b * previous[k, y, s]) for k in range(3 * count)]
        )
        for k in ti.static(range(3 * count)):
            out[k, y, s] = entries[k]
        constraints = ti.static([entries[3 * k : 3 * k + 3] for k in range(count)])
        scales = ti.static([(inverse_scale0, scale0), (inverse_scale1, scale1)])
        _, sums = ti.static(
            robust_data(terms_of(constraints), scales, flow[0, y, s], flow[1, y, s])
        )
        for k in ti.static(range(6)):
            tensor[k, y, s] = sums[k]
