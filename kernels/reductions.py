"""Sums over the image whose bits do not depend on the number of threads.

A kernel sums blocks of `BLOCK` strip positions of one row, each by one thread in one order; the
blocks are then added in float64, in the order of the image.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.diffusivity import stiffness_table
from tisfm.kernels.lanes import (
    LaneArray,
    LaneGrid,
    SumArray,
    lane_count,
    lane_kernel,
    lane_of,
)
from tisfm.kernels.rigid_motion import flow_of, motion_columns

BLOCK = 16
TINY = 1e-20


def block_sums(grid: LaneGrid, terms: int) -> np.ndarray:
    """Return zeros for the sums of every block, as a kernel takes them: (H, blocks, terms)."""
    shape = (grid.height, -(-grid.strip // BLOCK), terms)
    return np.zeros(shape, np.float32 if grid.lanes == 1 else np.float64)


def add_blocks(partial: np.ndarray) -> np.ndarray:
    """Return the sums over the image, (terms,) float64."""
    return partial.sum(axis=1, dtype=np.float64).sum(axis=0)


def energy(
    grid: LaneGrid,
    tensor,
    weights,
    edges,
    x_hat,
    y_hat,
    rho,
    *,
    alpha: float,
    contrast: float,
    stiffness=None,
    joint: bool = False,
) -> tuple[float, float, float]:
    """Compute the energy (eq. 6, 20) and its half-quadratic form (eq. 8, 21).

    The regularisation is that of edges: every edge once, g Σ_k Φ_δ(√s_k Δρ̂_k), or, joint,
    g Φ_δ of the length of the vector of all √s_k Δρ̂_k; Φ_δ(Δ) = 2Δ²/(1 + √(1 + Δ²/δ²)).

    Parameters
    ----------
    grid : LaneGrid
    tensor : lane array, 6 components
    weights : lane array, 2n components
        s_k·g·b, for the half-quadratic form.
    edges : lane array, 2 components
        g of the eastern and the southern edge.
    x_hat : column table
    y_hat : (H + 2,) float32
    rho : lane array, n components
    alpha : float
        α = λ̂β.
    contrast : float
        δ, px/frame; infinite for quadratic smoothness.
    stiffness : sequence of n floats, optional
        s_k, by default 1.
    joint : bool
        Whether an edge is one for all components.

    Returns
    -------
    data, smoothness, half_quadratic : float
        The quadratic form of the tensor, α Σ g Φ_δ, and α Σ g [bΔ² + δ²(b + 1/b − 2)]. The last
        two agree where b belongs to `rho`.
    """
    components = rho.shape[0]
    grid.check(tensor, 6, "tensor")
    grid.check(weights, 2 * components, "weights")
    grid.check(rho, components, "rho")
    grid.check(edges, 2, "edges")
    grid.check_columns(x_hat, "x_hat")
    grid.check_rows(y_hat, "y_hat")
    partial = block_sums(grid, 3)
    # With δ infinite, b is 1 and its penalty vanishes.
    squared = contrast * contrast if np.isfinite(contrast) else 0.0
    _energy[grid.lanes](
        tensor,
        weights,
        edges,
        x_hat,
        y_hat,
        rho,
        stiffness_table(stiffness, components),
        (1.0 / contrast) ** 2,
        squared,
        components,
        joint,
        partial,
    )
    data, smoothness, half_quadratic = add_blocks(partial)
    return float(data), float(alpha * smoothness), float(alpha * half_quadratic)


@lane_kernel
def _energy(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n, H+2, S+2)
    edges: LaneArray(3),  # (2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    rho: LaneArray(3),  # (n, H+2, S+2)
    stiffness: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    inverse_squared_contrast: ti.f32,
    squared_contrast: ti.f32,
    n: ti.template(),
    joint: ti.template(),
    partial: SumArray(3),  # (H, blocks, 3)
):
    height, strip = rho.shape[1] - 2, rho.shape[2] - 2
    blocks = partial.shape[1]
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        y = row + 1
        data, smooth, half = 0.0 * x_hat[1], 0.0 * x_hat[1], 0.0 * x_hat[1]
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            s = position + 1
            columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
            u, v = ti.static(flow_of(columns, [rho[k, y, s] for k in range(n)]))
            data += u * (tensor[0, y, s] * u + 2.0 * (tensor[1, y, s] * v + tensor[3, y, s]))
            data += v * (tensor[2, y, s] * v + 2.0 * tensor[4, y, s]) + tensor[5, y, s]
            for side in ti.static(range(2)):  # east, south
                g = edges[side, y, s]
                length = 0.0 * g
                for k in ti.static(range(n)):
                    step = rho[k, y + side, s + 1 - side] - rho[k, y, s]
                    square = stiffness[k] * step * step
                    if ti.static(joint):
                        length += square
                    else:
                        b = weights[n * side + k, y, s] / (stiffness[k] * ti.max(g, TINY))
                        smooth += g * aubert(square, inverse_squared_contrast)
                        half += g * (b * square + penalty(b, squared_contrast))
                if ti.static(joint):
                    b = weights[n * side, y, s] / (stiffness[0] * ti.max(g, TINY))
                    smooth += g * aubert(length, inverse_squared_contrast)
                    half += g * (b * length + penalty(b, squared_contrast))
        store_sum(partial, row, block, 0, data, ti.static(lane_count(rho)))
        store_sum(partial, row, block, 1, smooth, ti.static(lane_count(rho)))
        store_sum(partial, row, block, 2, half, ti.static(lane_count(rho)))


@ti.func
def aubert(square, inverse_squared_contrast):
    """Return Φ_δ of a squared difference."""
    return 2.0 * square / (1.0 + ti.sqrt(1.0 + square * inverse_squared_contrast))


@ti.func
def penalty(b, squared_contrast):
    """Return δ²(b + 1/b − 2)."""
    # (1 − b)²/b is b + 1/b − 2 without its cancellation.
    gap = 1.0 - b
    return squared_contrast * gap * gap / ti.max(b, TINY)


@ti.func
def store_sum(partial: ti.template(), row, block, term: ti.template(), value, lanes: ti.template()):
    """Write the sum of a value's lanes to an element of `partial`."""
    if ti.static(lanes == 1):
        partial[row, block, term] = value
    else:
        total = ti.cast(0.0, ti.f64)
        for lane in ti.static(range(lanes)):
            total += ti.cast(lane_of(value, lane, lanes), ti.f64)
        partial[row, block, term] = total


def change(grid: LaneGrid, rho, previous) -> tuple[float, float]:
    """Measure how far ρ̂ moved, and remember it.

    Parameters
    ----------
    grid : LaneGrid
    rho : lane array, n components
    previous : lane array, n components
        An earlier ρ̂; overwritten with `rho`.

    Returns
    -------
    moved, size : float
        ‖ρ̂ − previous‖ and ‖ρ̂‖, Euclidean norms over the image, px/frame.
    """
    components = rho.shape[0]
    grid.check(rho, components, "rho")
    grid.check(previous, components, "previous")
    partial = block_sums(grid, 2)
    _change[grid.lanes](rho, previous, components, partial)
    moved, size = np.sqrt(add_blocks(partial))
    return float(moved), float(size)


@lane_kernel
def _change(
    rho: LaneArray(3),  # (n, H+2, S+2)
    previous: LaneArray(3),  # (n, H+2, S+2), in place
    n: ti.template(),
    partial: SumArray(3),  # (H, blocks, 2)
):
    height, strip = rho.shape[1] - 2, rho.shape[2] - 2
    blocks = partial.shape[1]
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        y = row + 1
        moved, size = 0.0 * rho[0, y, 1], 0.0 * rho[0, y, 1]
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            s = position + 1
            for k in ti.static(range(n)):
                value = rho[k, y, s]
                step = value - previous[k, y, s]
                moved += step * step
                size += value * value
                previous[k, y, s] = value
        store_sum(partial, row, block, 0, moved, ti.static(lane_count(rho)))
        store_sum(partial, row, block, 1, size, ti.static(lane_count(rho)))
