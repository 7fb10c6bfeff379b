"""What a half-quadratic iteration does besides relaxation, in one pass over memory."""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from tisfm.kernels.diffusivity import stiffness_table
from tisfm.kernels.lanes import (
    LaneArray,
    LaneGrid,
    SumArray,
    lane_count,
    lane_kernel,
    refresh_halo,
)
from tisfm.kernels.reductions import (
    BLOCK,
    TINY,
    add_blocks,
    aubert,
    block_sums,
    penalty,
    store_sum,
)
from tisfm.kernels.rigid_motion import flow_of, motion_columns
from tisfm.kernels.robust import check_terms, finite_scales, quadratic


@dataclass(frozen=True)
class Sums:
    """Sums over the image.

    Attributes
    ----------
    energy : float
        Energy (eq. 6, 20): robust data term and α Σ g Φ_δ.
    half_quadratic : float
        Its half-quadratic form (eq. 8, 21), with the weights and the tensor from before.
    moved, size : float
        ‖ρ̂ − previous‖ and ‖ρ̂‖, Euclidean norms over the image, px/frame.
    """

    energy: float
    half_quadratic: float
    moved: float
    size: float


def advance(
    grid: LaneGrid,
    terms,
    edges,
    x_hat,
    y_hat,
    rho,
    weights,
    tensor,
    previous,
    *,
    alpha: float,
    contrast: float,
    stiffness,
    joint: bool,
    scales,
) -> Sums:
    """Measure ρ̂, and renew the auxiliary fields for it.

    It does in one pass what `edge_weights`, `robust_tensor`, `robust_energy`, `energy` and
    `change` do, each of which says what its part is.

    Parameters
    ----------
    grid : LaneGrid
    terms : lane array, 6 components for each of 1 or 2 terms
        Motion tensors.
    edges : lane array, 2 components
    x_hat : column table
    y_hat : (H + 2,) float32
    rho : lane array, n components
        ρ̂, px/frame.
    weights : lane array, 2n components
        s_k·g·b; those from before enter the half-quadratic energy. Overwritten.
    tensor : lane array, 6 components
        Σ w_i J_i; likewise.
    previous : lane array, n components
        An earlier ρ̂; overwritten with `rho`.
    alpha : float
        α = λ̂β.
    contrast : float
        δ, px/frame; infinite for quadratic smoothness.
    stiffness : sequence of n floats
        s_k.
    joint : bool
        Whether an edge is one for all components.
    scales : sequence of float
        m_i ε² of each term; infinite for a quadratic one.
    """
    components = rho.shape[0]
    count = check_terms(grid, terms, x_hat, y_hat, rho, scales)
    grid.check(weights, 2 * components, "weights")
    grid.check(tensor, 6, "tensor")
    grid.check(edges, 2, "edges")
    grid.check(previous, components, "previous")
    if not contrast > 0:
        raise ValueError(f"contrast is {contrast}: expected a positive value, in px/frame")
    partial = block_sums(grid, 6)
    _advance[grid.lanes](
        terms,
        edges,
        x_hat,
        y_hat,
        rho,
        stiffness_table(stiffness, components),
        (1.0 / contrast) ** 2,
        # With δ infinite, b is 1 and its penalty vanishes.
        contrast * contrast if np.isfinite(contrast) else 0.0,
        *finite_scales(scales),
        components,
        joint,
        count,
        weights,
        tensor,
        previous,
        partial,
    )
    data, half_data, smooth, half_smooth, moved, size = add_blocks(partial)
    return Sums(
        energy=float(data + alpha * smooth),
        half_quadratic=float(half_data + alpha * half_smooth),
        moved=float(np.sqrt(moved)),
        size=float(np.sqrt(size)),
    )


@lane_kernel
def _advance(
    terms: LaneArray(3),  # (6 or 12, H+2, S+2)
    edges: LaneArray(3),  # (2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    rho: LaneArray(3),  # (n, H+2, S+2)
    stiffness: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    inverse_squared_contrast: ti.f32,
    squared_contrast: ti.f32,
    inverse0: ti.f32,
    scale0: ti.f32,
    inverse1: ti.f32,
    scale1: ti.f32,
    n: ti.template(),
    joint: ti.template(),
    count: ti.template(),
    weights: LaneArray(3),  # (2n, H+2, S+2), in place
    tensor: LaneArray(3),  # (6, H+2, S+2), in place
    previous: LaneArray(3),  # (n, H+2, S+2), in place
    partial: SumArray(3),  # (H, blocks, 6)
):
    height, strip = rho.shape[1] - 2, rho.shape[2] - 2
    blocks = partial.shape[1]
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        y = row + 1
        zero = 0.0 * x_hat[1]
        data, half_data, smooth, half_smooth, moved, size = zero, zero, zero, zero, zero, zero
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            s = position + 1
            columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
            u, v = ti.static(flow_of(columns, [rho[k, y, s] for k in range(n)]))
            half_data += u * (tensor[0, y, s] * u + 2.0 * (tensor[1, y, s] * v + tensor[3, y, s]))
            half_data += v * (tensor[2, y, s] * v + 2.0 * tensor[4, y, s]) + tensor[5, y, s]
            q0 = quadratic(terms, 0, y, s, u, v)
            root0 = ti.sqrt(1.0 + inverse0 * q0)
            w0 = 1.0 / root0
            data += 2.0 * q0 / (1.0 + root0)
            constant = scale0 * (1.0 - w0) * (root0 - 1.0)  # m ε²(w + 1/w − 2)
            if ti.static(count == 1):
                for k in ti.static(range(5)):
                    tensor[k, y, s] = w0 * terms[k, y, s]
                tensor[5, y, s] = w0 * terms[5, y, s] + constant
            else:
                q1 = quadratic(terms, 6, y, s, u, v)
                root1 = ti.sqrt(1.0 + inverse1 * q1)
                w1 = 1.0 / root1
                data += 2.0 * q1 / (1.0 + root1)
                constant += scale1 * (1.0 - w1) * (root1 - 1.0)
                for k in ti.static(range(5)):
                    tensor[k, y, s] = w0 * terms[k, y, s] + w1 * terms[6 + k, y, s]
                tensor[5, y, s] = w0 * terms[5, y, s] + w1 * terms[11, y, s] + constant
            for side in ti.static(range(2)):  # east, south
                g = edges[side, y, s]
                length = 0.0 * g
                for k in ti.static(range(n)):
                    step = rho[k, y + side, s + 1 - side] - rho[k, y, s]
                    square = stiffness[k] * step * step
                    if ti.static(joint):
                        length += square
                    else:
                        before = weights[n * side + k, y, s] / (stiffness[k] * ti.max(g, TINY))
                        smooth += g * aubert(square, inverse_squared_contrast)
                        half_smooth += g * (before * square + penalty(before, squared_contrast))
                        b = 1.0 / ti.sqrt(1.0 + inverse_squared_contrast * square)
                        weights[n * side + k, y, s] = stiffness[k] * g * b
                if ti.static(joint):
                    before = weights[n * side, y, s] / (stiffness[0] * ti.max(g, TINY))
                    smooth += g * aubert(length, inverse_squared_contrast)
                    half_smooth += g * (before * length + penalty(before, squared_contrast))
                    b = g / ti.sqrt(1.0 + inverse_squared_contrast * length)
                    for k in ti.static(range(n)):
                        weights[n * side + k, y, s] = stiffness[k] * b
            for k in ti.static(range(n)):
                value = rho[k, y, s]
                step = value - previous[k, y, s]
                moved += step * step
                size += value * value
                previous[k, y, s] = value
        for term, value in ti.static(
            enumerate((data, half_data, smooth, half_smooth, moved, size))
        ):
            store_sum(partial, row, block, term, value, ti.static(lane_count(rho)))
    # The western weight of a strip's first column is the eastern one of its neighbour's last.
    if ti.static(lane_count(rho) > 1):
        for k, row in ti.ndrange(n, height):
            refresh_halo(weights, k, row + 1)
