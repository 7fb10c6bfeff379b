"""Precision of a pixel's image motion from its data, and its covariance from its neighbours.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, check_array, lane_kernel
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.kernels.model.rigid_motion import flow_of, motion_columns


def data_precision(
    grid: LaneGrid,
    # arrays of a `tisfm.kernels.solve.linear_system.LinearSystem`, which has checked them
    arrays: tuple[LaneData, ...],
    rho: LaneData,  # lane array, n components
    # lane array, 7 components: J11, J12, J22; the data term at ρ̂, which is the squared residual;
    # and M11, M12, M22 of M = G (diag α_k b̄)⁻¹ Gᵀ, the covariance of a pixel's flow given its
    # neighbours, in units in which J is the precision of its data
    out: LaneData,
) -> None:
    """Compute precision and residual of the data, and the covariance given the neighbours."""
    weight_count = arrays[1].shape[0] // 2
    _data_precision[grid.lanes](*arrays, rho, rho.shape[0], weight_count, out)


@lane_kernel
def _data_precision(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    alpha: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    rho: LaneArray(3),  # (n, H+2, S+2)
    n: ti.template(),
    weight_count: ti.template(),  # weights of an edge: n, or 1
    out: LaneArray(3),  # (7, H+2, S+2)
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
        u, v = ti.static(flow_of(columns, [rho[k, y, s] for k in range(n)]))
        residual = u * (tensor[0, y, s] * u + 2.0 * (tensor[1, y, s] * v + tensor[3, y, s]))
        residual += v * (tensor[2, y, s] * v + 2.0 * tensor[4, y, s]) + tensor[5, y, s]
        m11, m12, m22 = 0.0 * x_hat[s], 0.0 * x_hat[s], 0.0 * x_hat[s]
        for k in ti.static(range(n)):
            a, b = ti.static(columns[k])
            east, south = ti.static(k % weight_count, weight_count + k % weight_count)
            weight_sum = weights[east, y, s] + weights[east, y, s - 1]
            weight_sum += weights[south, y, s] + weights[south, y - 1, s]
            variance = 1.0 / (alpha[k] * weight_sum + MIN_DIVISOR)
            m11 += a * a * variance
            m12 += a * b * variance
            m22 += b * b * variance
        for k in ti.static(range(3)):
            out[k, y, s] = tensor[k, y, s]
        out[3, y, s] = ti.max(residual, 0.0)  # rounding may make the square negative
        out[4, y, s] = m11
        out[5, y, s] = m12
        out[6, y, s] = m22


def share_of_data(
    precision: np.ndarray,  # (7, H, W) float32: J11, J12, J22, squared residual, M11, M12, M22
    out: np.ndarray,  # (H, W) float32: the share of the data in the precision of a pixel's flow
    *,
    half_share_residual: float,  # the squared residual that halves the share; above 0
    freedom: int,  # {2, 1}: degrees of freedom of a pixel's flow; if 1, M is of rank 1
) -> None:
    """Compute tr[J M (I + J M)⁻¹]/freedom, divided by 1 + residual/half_share_residual."""
    check_array(out, out.shape[:2], "out", aligned=False)
    check_array(precision, (7, *out.shape), "precision", aligned=False)
    if freedom not in (1, 2):
        raise ValueError(f"freedom is {freedom}: expected 1 or 2")
    if not half_share_residual > 0:
        raise ValueError(f"half_share_residual is {half_share_residual}: expected a positive value")
    flat = precision.reshape(7, -1), out.reshape(-1)  # one index: no address from row and column
    _share_of_data(flat[0], 1.0 / half_share_residual, 1.0 - 1.0 / freedom, flat[1])


@Kernel
def _share_of_data(
    precision: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (7, H·W)
    residual_scale: ti.f32,
    fixed_share: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H·W,)
):
    for i in range(out.shape[0]):
        j11, j12, j22 = precision[0, i], precision[1, i], precision[2, i]
        m11, m12, m22 = precision[4, i], precision[5, i], precision[6, i]
        trace = j11 * m11 + 2.0 * j12 * m12 + j22 * m22
        # det(I + J M) = 1 + tr(J M) + det J · det M
        determinant = ti.max(j11 * j22 - j12 * j12, 0.0) * ti.max(m11 * m22 - m12 * m12, 0.0)
        determinant += 1.0 + trace
        share = 1.0 - (1.0 + fixed_share * trace) / determinant
        out[i] = share / (1.0 + residual_scale * precision[3, i])
