"""Constraints from the frames on both sides of a frame, as one set."""

from collections.abc import Sequence

import taichi as ti

from tisfm.kernels.layout.internals import bind
from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.model.robust import check_constraints, finite_scales, robust_data, terms_of


@operation
def backward_flow(grid: LaneGrid, flow: LaneData, bend: LaneData, out: LaneData) -> Launch:
    """Write the flow to the frame before: that to the next one, turned round, and the bend of both.

    Parameters
    ----------
    grid : LaneGrid
    flow, bend : lane arrays, 2 components
        px/frame.
    out : lane array, 2 components
        bend − flow.
    """
    for array, name in ((flow, "flow"), (bend, "bend"), (out, "out")):
        grid.check(array, 2, name)
    return _backward_flow[grid.lanes].bind(flow, bend, grid.serial, out)


@lane_kernel
def _backward_flow(
    flow: LaneArray(3),  # (2, H+2, S+2)
    bend: LaneArray(3),  # (2, H+2, S+2)
    serial: ti.template(),
    out: LaneArray(3),  # (2, H+2, S+2)
):
    ti.loop_config(serialize=serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        for k in ti.static(range(2)):
            out[k, y, s] = bend[k, y, s] - flow[k, y, s]


@operation
def join_constraints(
    grid: LaneGrid,
    before: LaneData,
    trust: LaneData,
    mask: LaneData,
    mask_before: LaneData,
    flow: LaneData,
    scales: Sequence[float],
    out: LaneData,
    tensor: LaneData,
) -> Launch:
    """Join the constraints of the next frame with those of the one before, in place.

    With weights a and b, of the trust in each times its mask, the constraint is (a A + b B) /
    max(1, a + b): the mean of both where both are seen, which halves the noise of the frame they
    share, and the one that is seen elsewhere.

    Parameters
    ----------
    grid : LaneGrid
    before : lane array, 3 components for each constraint
        (p, q, c) of the frame before, as constraints on the flow to the next one.
    trust : lane array, 2 components
        In [0, 1]: whether a pixel is seen in the next frame, and in the one before.
    mask, mask_before : lane arrays, 1 component
        Those of the constraints of each.
    flow : lane array, 2 components
        px/frame, at which the tensor is weighted.
    scales : sequence of float
        m_i ε² of each term in use (`tisfm.kernels.model.robust`).
    out : lane array, 3 components for each constraint
        (p, q, c) of the next frame, which become the joint ones.
    tensor : lane array, 6 components
        Σ w_i J_i with the robust weights at the flow.
    """
    count = check_constraints(grid, out, scales)
    grid.check(before, 3 * count, "before")
    for array, n, name in (
        (trust, 2, "trust"),
        (mask, 1, "mask"),
        (mask_before, 1, "mask_before"),
        (flow, 2, "flow"),
        (tensor, 6, "tensor"),
    ):
        grid.check(array, n, name)
    return _join[grid.lanes].bind(
        before,
        trust,
        mask,
        mask_before,
        flow,
        *finite_scales(scales),
        count,
        grid.serial,
        out,
        tensor,
    )


@lane_kernel
def _join(
    before: LaneArray(3),  # (3 count, H+2, S+2)
    trust: LaneArray(3),  # (2, H+2, S+2)
    mask: LaneArray(3),  # (1, H+2, S+2)
    mask_before: LaneArray(3),  # (1, H+2, S+2)
    flow: LaneArray(3),  # (2, H+2, S+2)
    inverse0: ti.f32,
    scale0: ti.f32,
    inverse1: ti.f32,
    scale1: ti.f32,
    count: ti.template(),
    serial: ti.template(),
    out: LaneArray(3),  # (3 count, H+2, S+2), in place
    tensor: LaneArray(3),  # (6, H+2, S+2)
):
    ti.loop_config(serialize=serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        after, earlier = trust[0, y, s] * mask[0, y, s], trust[1, y, s] * mask_before[0, y, s]
        inverse = 1.0 / ti.max(1.0, after + earlier)
        a, b = inverse * after, inverse * earlier
        entries = ti.static(
            [bind(a * out[k, y, s] + b * before[k, y, s]) for k in range(3 * count)]
        )
        for k in ti.static(range(3 * count)):
            out[k, y, s] = entries[k]
        lines = ti.static([entries[3 * k : 3 * k + 3] for k in range(count)])
        scales = ti.static([(inverse0, scale0), (inverse1, scale1)])
        _, sums = ti.static(robust_data(terms_of(lines), scales, flow[0, y, s], flow[1, y, s]))
        for k in ti.static(range(6)):
            tensor[k, y, s] = sums[k]
