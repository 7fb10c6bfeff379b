"""Update of weights and tensor in a half-quadratic iteration, with energies, in a single pass.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    CHUNK,
    INDEX_MASK,
    LaneArray,
    LaneData,
    LaneGrid,
    SumArray,
    component_starts,
    element,
    first_row,
    lane_count,
    lane_kernel,
    load,
    refresh_halo,
    store,
)
from tisfm.kernels.layout.reductions import BLOCK, add_blocks, block_sums, store_sum
from tisfm.kernels.model import MIN_PIVOT
from tisfm.kernels.model.rigid_motion import flow_of, motion_columns
from tisfm.kernels.model.robust import robust_data, scale_pairs, terms_of

LINE_ENTRIES = (0, 3, 5)  # J11, j1 and J_tt: the nonzero entries of a tensor along a line
BAND_ROWS = 4  # rows of a band, which one thread processes at a time


@dataclass(frozen=True)
class Sums:
    """Sums over the image."""

    # Equations are numbered as in the paper that docs/method.md cites.
    energy: float  # Energy (eq. 6, 20): robust data term and α Σ g Φ_δ.
    # Half-quadratic energy (eq. 8, 21) with the weights and the tensor before the update.
    half_quadratic: float
    # change, size: ‖ρ̂ − previous‖ and ‖ρ̂‖, Euclidean norms over the image, px/frame
    change: float
    size: float


def bind_update(
    grid: LaneGrid,
    # Arrays of a `tisfm.kernels.solve.linear_system.LinearSystem`, which has checked them. Its
    # previous weights g·b and tensor Σ w_i J_i give the half-quadratic energy; then both are
    # overwritten.
    arrays: tuple[LaneData, ...],
    rho: LaneData,  # lane array, n components: ρ̂, px/frame
    previous: LaneData,  # lane array, n components: an earlier ρ̂; overwritten with `rho`
    # lane array, 3 components for each of 1 to 3 constraints: (p, q, c)
    # (`tisfm.kernels.data.constraints`)
    constraints: LaneData,
    edges: LaneData,  # lane array, 2 components: g, the image-driven factor of smoothness
    *,
    alpha: float,  # α, the strength of the smoothness: λ̂β of the paper
    stiffness: np.ndarray,  # (n,) float32: s_k
    contrast: float,  # δ, px/frame; infinite for quadratic smoothness
    scales: Sequence[float],  # m_i ε² of each term; infinite for a quadratic term
    # Whether q is 0 in all constraints, for n = 1. Then only J11, j1 and J_tt of the tensor are
    # written.
    along_line: bool,
) -> Callable[[], Sums]:
    """Return a function that computes energies and changes of ρ̂, and the weights for ρ̂.

    An edge contributes g Φ_δ(√s_k Δρ̂_k) for every k, or, if joint, g Φ_δ of the length of the
    vector of all √s_k Δρ̂_k, with Φ_δ(Δ) = 2Δ²/(1 + √(1 + Δ²/δ²)). Its half-quadratic form is
    g [bΔ² + δ²(b + 1/b − 2)], with its minimum at b = 1/√(1 + Δ²/δ²). The data term is treated in
    the same way (`tisfm.kernels.model.robust`).
    """
    if not contrast > 0:
        raise ValueError(f"contrast is {contrast}: expected a positive value, in px/frame")
    tensor, weights, x_hat, y_hat, _ = arrays
    partial = block_sums(grid, 6)
    launch = _update[grid.lanes].bind(
        constraints,
        edges,
        x_hat,
        y_hat,
        rho,
        stiffness,
        (1.0 / contrast) ** 2,
        # With infinite δ, b is 1 and its penalty is 0.
        contrast * contrast if np.isfinite(contrast) else 0.0,
        *scale_pairs(scales),
        rho.shape[0],
        weights.shape[0] // 2,
        constraints.shape[0] // 3,
        along_line,
        grid.is_serial,
        -(-grid.height // BAND_ROWS),
        weights,
        tensor,
        previous,
        partial,
    )

    def run() -> Sums:
        launch()
        (
            data,
            half_data,
            smoothness,
            half_smoothness,
            change,
            size,
        ) = add_blocks(partial)
        return Sums(
            energy=float(data + alpha * smoothness),
            half_quadratic=float(half_data + alpha * half_smoothness),
            change=float(np.sqrt(change)),
            size=float(np.sqrt(size)),
        )

    return run


@lane_kernel
def _update(
    terms: LaneArray(3),  # (3 count, H+2, S+2)
    edges: LaneArray(3),  # (2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    rho: LaneArray(3),  # (n, H+2, S+2)
    stiffness: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    inverse_squared_contrast: ti.f32,
    squared_contrast: ti.f32,
    inverse_scale0: ti.f32,
    scale0: ti.f32,
    inverse_scale1: ti.f32,
    scale1: ti.f32,
    n: ti.template(),
    weight_count: ti.template(),  # weights of an edge: n, or 1
    count: ti.template(),
    along_line: ti.template(),
    is_serial: ti.template(),
    bands: ti.i32,
    weights: LaneArray(3),  # (2n or 2, H+2, S+2), in place
    tensor: LaneArray(3),  # (6, H+2, S+2), in place
    previous: LaneArray(3),  # (n, H+2, S+2), in place
    partial: SumArray(3),  # (H, blocks, 6)
):
    height = rho.shape[1] - 2
    blocks = partial.shape[1]
    if ti.static(lane_count(rho) == 1):
        for index in range(height * blocks):
            stride = rho.shape[2] & INDEX_MASK
            starts = ti.static(component_starts(rho, max(6, 3 * count, 2 * weight_count)))
            _update_block(
                terms, edges, x_hat, y_hat, rho, stiffness, inverse_squared_contrast,
                squared_contrast, inverse_scale0, scale0, inverse_scale1, scale1, n, weight_count,
                count, along_line, weights, tensor, previous, partial, stride, starts,
                index // blocks, index % blocks,
            )  # fmt: skip
    else:
        chunk = ti.static(1 if is_serial else CHUNK)
        ti.loop_config(serialize=is_serial)
        for task in range(chunk * bands):
            if task % chunk == 0:
                band = task // chunk
                stride = rho.shape[2] & INDEX_MASK
                starts = ti.static(component_starts(rho, max(6, 3 * count, 2 * weight_count)))
                for row in range(
                    first_row(band, height, bands), first_row(band + 1, height, bands)
                ):
                    for block in range(blocks):
                        _update_block(
                            terms, edges, x_hat, y_hat, rho, stiffness, inverse_squared_contrast,
                            squared_contrast, inverse_scale0, scale0, inverse_scale1, scale1, n,
                            weight_count, count, along_line, weights, tensor, previous, partial,
                            stride, starts, row, block,
                        )  # fmt: skip
                    # The first column of a strip reads its western weight from the halo: the
                    # eastern weight of the neighbouring strip's last column.
                    for k in range(weight_count):
                        refresh_halo(weights, k, row + 1)


@ti.func
def _update_block(
    terms: ti.template(), edges: ti.template(), x_hat: ti.template(), y_hat: ti.template(),
    rho: ti.template(), stiffness: ti.template(), inverse_squared_contrast, squared_contrast,
    inverse_scale0, scale0, inverse_scale1, scale1, n: ti.template(), weight_count: ti.template(),
    count: ti.template(), along_line: ti.template(), weights: ti.template(), tensor: ti.template(),
    previous: ti.template(), partial: ti.template(), stride, starts: ti.template(), row, block,
):  # fmt: skip
    """Update one block of a row."""
    y, strip = row + 1, rho.shape[2] - 2
    zero = 0.0 * x_hat[1]
    # Energies of data and smoothness: robust, and half-quadratic with the old weights.
    data, half_data, smoothness, half_smoothness, change, size = (
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
    )
    for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
        s = position + 1
        i = (y * stride + s) & INDEX_MASK
        center = ti.static([bind(element(rho, i + starts[k])) for k in range(n)])
        columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
        u, v = ti.static(flow_of(columns, center))
        j = ti.static([bind(element(tensor, i + starts[k])) for k in range(6)])
        half_data += u * (j[0] * u + 2.0 * (j[1] * v + j[3])) + v * (j[2] * v + 2.0 * j[4]) + j[5]
        entries = ti.static([bind(element(terms, i + starts[k])) for k in range(3 * count)])
        lines = ti.static([entries[3 * k : 3 * k + 3] for k in range(count)])
        scales = ti.static([(inverse_scale0, scale0), (inverse_scale1, scale1)])
        energy, sums = ti.static(robust_data(terms_of(lines), scales, u, v))
        data += energy
        for k in ti.static(LINE_ENTRIES if along_line else range(6)):
            store(tensor, i + starts[k], sums[k])
        for side in ti.static(range(2)):  # east, south
            g = load(edges, i + starts[side])
            neighbour = i + 1 + side * (stride - 1)
            steps = ti.static(
                [bind(element(rho, neighbour + starts[k]) - center[k]) for k in range(n)]
            )
            squares = ti.static([bind(stiffness[k] * steps[k] * steps[k]) for k in range(n)])
            lengths = ti.static(squares if weight_count == n else [_sum(squares)])
            for k in ti.static(range(weight_count)):
                index = i + starts[weight_count * side + k]
                square, old_weight = lengths[k], load(weights, index)
                root = ti.sqrt(1.0 + inverse_squared_contrast * square)
                factor = g / (root * (1.0 + root))  # one division, as slow as many products
                smoothness += 2.0 * square * (root * factor)  # g Φ_δ
                # g [bΔ² + δ²(b + 1/b − 2)], b + 1/b − 2 = (1 − b)²/b, for b = old_weight/g.
                difference = g - old_weight
                half_smoothness += old_weight * square
                half_smoothness += (
                    squared_contrast * difference * difference / ti.max(old_weight, MIN_PIVOT)
                )
                store(weights, index, factor * (1.0 + root))  # g b
        for k in ti.static(range(n)):
            index = i + starts[k]
            step = center[k] - load(previous, index)
            change += step * step
            size += center[k] * center[k]
            store(previous, index, center[k])
    for term, value in ti.static(
        enumerate(
            (
                data,
                half_data,
                smoothness,
                half_smoothness,
                change,
                size,
            )
        )
    ):
        store_sum(partial, row, block, term, value, ti.static(lane_count(rho)))


def _sum(values: list) -> Any:
    total = values[0]
    for value in values[1:]:
        total = total + value
    return bind(total)
