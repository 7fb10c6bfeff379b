"""What data and neighbours each say about the image motion of a pixel."""

import taichi as ti

from tisfm.kernels.edges import component_table, weight_sets
from tisfm.kernels.lanes import LaneArray, LaneGrid, lane_kernel
from tisfm.kernels.rigid_motion import flow_of, motion_columns
from tisfm.kernels.small_spd import DIAGONAL_FLOOR


def evidence(grid: LaneGrid, tensor, weights, x_hat, y_hat, rho, out, *, alpha) -> None:
    """Compute the data's curvature and residual, and the covariance that neighbours leave.

    Parameters
    ----------
    grid : LaneGrid
    tensor : lane array, 6 components
    weights : lane array, 2n or 2 components
    x_hat : column table
    y_hat : (H + 2,) float32
    rho : lane array, n components
    out : lane array, 7 components
        J11, J12, J22; the data term at ρ̂, which is the squared residual; and M11, M12, M22 of
        M = G (diag α_k b̄)⁻¹ Gᵀ, the covariance of the flow of a pixel given its neighbours, in the
        units in which J is the precision that its data add.
    alpha : float or n floats
        α_k = λ̂β s_k.
    """
    components = rho.shape[0]
    grid.check(tensor, 6, "tensor")
    sets = weight_sets(grid, weights, components)
    grid.check(rho, components, "rho")
    grid.check_columns(x_hat, "x_hat")
    grid.check_rows(y_hat, "y_hat")
    grid.check(out, 7, "out")
    alphas = component_table(alpha, components)
    _evidence[grid.lanes](tensor, weights, x_hat, y_hat, rho, alphas, components, sets, out)


@lane_kernel
def _evidence(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    rho: LaneArray(3),  # (n, H+2, S+2)
    alpha: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    n: ti.template(),
    sets: ti.template(),
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
            east, south = ti.static(k % sets, sets + k % sets)
            neighbours = weights[east, y, s] + weights[east, y, s - 1]
            neighbours += weights[south, y, s] + weights[south, y - 1, s]
            variance = 1.0 / (alpha[k] * neighbours + DIAGONAL_FLOOR)
            m11 += a * a * variance
            m12 += a * b * variance
            m22 += b * b * variance
        for k in ti.static(range(3)):
            out[k, y, s] = tensor[k, y, s]
        out[3, y, s] = ti.max(residual, 0.0)  # a square, but for its rounding
        out[4, y, s] = m11
        out[5, y, s] = m12
        out[6, y, s] = m22
