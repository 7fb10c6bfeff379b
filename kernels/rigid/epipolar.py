"""Flow of rigid motions: every pixel moves along its epipolar line, depending on inverse depth.

A pixel x̂ = (x̂, ŷ, 1) with inverse depth d on a surface that moves by P₁ = R P₀ + t moves exactly
to π(R x̂ + d t). The unknown of the solver is D = f·d. Near a current D₀ the flow is
(u, v) = (u₀, v₀) + (D − D₀) a, with a = ∂(u, v)/∂D the direction of the epipolar line. A constraint
on the flow is then a constraint on D.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, check_array, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.model import MIN_DEPTH_RATIO


@operation
def displacement(
    grid: LaneGrid,
    inverse_depth: LaneData,  # lane array, 1 component: D
    # lane array, 1 component: index of each pixel's motion, a whole number from 0
    labels: LaneData,
    # x_hat, y_hat: normalised coordinates of columns, as from `LaneGrid.columns`, and of rows,
    # (H + 2,) float32
    x_hat: LaneData,
    y_hat: LaneData,
    flow: LaneData,  # lane array, 2 components: (u, v) = f·(π(R x̂ + d t) − x̂), px/frame
    direction: LaneData,  # lane array, 2 components: a = ∂(u, v)/∂D
    *,
    motions: np.ndarray,  # (K, 3, 4) float32: R and t of each motion
    focal: float,  # px
) -> Launch:
    """Compute the flow of rigid motions, and its derivative by the inverse depth."""
    check_geometry(grid, inverse_depth, labels, x_hat, y_hat, motions)
    grid.check(flow, 2, "flow")
    grid.check(direction, 2, "direction")
    return _displacement[grid.lanes].bind(
        inverse_depth, labels, x_hat, y_hat, motions, focal, flow, direction
    )


@operation
def restrict_to_line(
    grid: LaneGrid,
    # lane array, 3 components for each constraint: (p, q, c) (`tisfm.kernels.data.constraints`)
    terms: LaneData,
    # flow, direction: lane arrays, 2 components: results of `displacement` for the same D
    flow: LaneData,
    direction: LaneData,
    inverse_depth: LaneData,  # lane array, 1 component: D₀
    # lane array, as many components as `terms`: (p', 0, c'), a constraint on the flow (D, 0): p' =
    # (p, q)·a, and c' = (p, q)·(u₀, v₀) + c − p' D₀. The zeros are not written.
    out: LaneData,
) -> Launch:
    """Restrict constraints to the epipolar line."""
    count = terms.shape[0] // 3
    grid.check(terms, 3 * count, "terms")
    grid.check(flow, 2, "flow")
    grid.check(direction, 2, "direction")
    grid.check(inverse_depth, 1, "inverse_depth")
    grid.check(out, 3 * count, "out")
    return _restrict_to_line[grid.lanes].bind(terms, flow, direction, inverse_depth, count, out)


def check_geometry(
    grid: LaneGrid,
    inverse_depth: LaneData,
    labels: LaneData,
    x_hat: LaneData,
    y_hat: LaneData,
    motions: np.ndarray,
) -> None:
    """Raise unless the input arguments of `displacement` have the right types and shapes."""
    grid.check(inverse_depth, 1, "inverse_depth")
    grid.check(labels, 1, "labels")
    grid.check_columns(x_hat, "x_hat")
    grid.check_rows(y_hat, "y_hat")
    count = motions.shape[0] if isinstance(motions, np.ndarray) and motions.ndim == 3 else 1
    check_array(motions, (count, 3, 4), "motions", aligned=False)
    if not count:
        raise ValueError("motions is empty: expected at least one")


@lane_kernel
def _displacement(
    inverse_depth: LaneArray(3),  # (1, H+2, S+2)
    labels: LaneArray(3),  # (1, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    motions: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (K, 3, 4)
    focal: ti.f32,
    flow: LaneArray(3),  # (2, H+2, S+2)
    direction: LaneArray(3),  # (2, H+2, S+2)
):
    for row, position in ti.ndrange(flow.shape[1] - 2, flow.shape[2] - 2):
        y, s = row + 1, position + 1
        x0, y0 = x_hat[s], y_hat[y]
        d = inverse_depth[0, y, s] / focal
        p1, p2, p3 = 0.0 * d, 0.0 * d, 0.0 * d
        t1, t2, t3 = 0.0 * d, 0.0 * d, 0.0 * d
        for k in range(motions.shape[0]):
            difference = labels[0, y, s] - ti.cast(k, ti.f32)
            # 1 for label k, else 0
            is_label = ti.max(1.0 - ti.max(difference, 0.0 - difference), 0.0)
            p1 += is_label * _coordinate(motions, k, 0, x0, y0)
            p2 += is_label * _coordinate(motions, k, 1, x0, y0)
            p3 += is_label * _coordinate(motions, k, 2, x0, y0)
            t1 += is_label * motions[k, 0, 3]
            t2 += is_label * motions[k, 1, 3]
            t3 += is_label * motions[k, 2, 3]
        nearness = 1.0 / ti.max(p3 + d * t3, MIN_DEPTH_RATIO)
        x1 = nearness * (p1 + d * t1)
        y1 = nearness * (p2 + d * t2)
        flow[0, y, s] = focal * (x1 - x0)
        flow[1, y, s] = focal * (y1 - y0)
        direction[0, y, s] = nearness * (t1 - x1 * t3)
        direction[1, y, s] = nearness * (t2 - y1 * t3)


@ti.func
def _coordinate(motions: ti.template(), k, row: ti.template(), x, y):
    """Return one coordinate of R x̂."""
    return motions[k, row, 0] * x + motions[k, row, 1] * y + motions[k, row, 2]


@lane_kernel
def _restrict_to_line(
    terms: LaneArray(3),  # (3 count, H+2, S+2)
    flow: LaneArray(3),  # (2, H+2, S+2)
    direction: LaneArray(3),  # (2, H+2, S+2)
    inverse_depth: LaneArray(3),  # (1, H+2, S+2)
    count: ti.template(),
    out: LaneArray(3),  # (3 count, H+2, S+2)
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        a, b = direction[0, y, s], direction[1, y, s]
        d = inverse_depth[0, y, s]
        u, v = flow[0, y, s] - d * a, flow[1, y, s] - d * b
        for i in ti.static(range(count)):
            p, q = terms[3 * i, y, s], terms[3 * i + 1, y, s]
            out[3 * i, y, s] = p * a + q * b
            out[3 * i + 2, y, s] = p * u + q * v + terms[3 * i + 2, y, s]
