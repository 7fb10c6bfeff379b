"""Update of weights and tensor in a half-quadratic iteration, with energies, in a single pass.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable, Sequence
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
from tisfm.kernels.model.robust import robust_data, scale_pairs, terms_of
from tisfm.kernels.solve.second_order.stencil import COMPONENTS, WEIGHTS
from tisfm.kernels.solve.weight_update import BAND_ROWS, Sums


def bind_update(
    grid: LaneGrid,
    # Tensor and weights of a `tisfm.kernels.solve.second_order.system.SecondOrderSystem`, which has
    # checked all arrays. Their previous values give the half-quadratic energy; then both are
    # overwritten.
    arrays: tuple[LaneData, ...],
    rho: LaneData,  # lane array, 3 components: D, v₁, v₂
    previous: LaneData,  # lane array, 1 component: an earlier D; overwritten with the present D
    # lane array, 2 components: w and D*, px/frame; D* must be finite even where w is 0
    anchors: LaneData,
    edges: LaneData,  # lane array, 2 components: g, the image-driven factor of smoothness
    # lane array, 3 components for each of 1 to 3 constraints, or None: (p, 0, c) of p D + c = 0
    constraints: LaneData | None,
    *,
    half_h: float,  # h/2
    stiffness: tuple[float, float, float],  # (α, β, γ)
    # 3 floats: δ of r, of |Δv| and of ΔD; infinite for a quadratic penalty
    contrasts: tuple[float, float, float],
    anchor_scale: float,  # σ, px/frame; infinite for a quadratic penalty
    # m_i ε² of each term of the constraints (`tisfm.kernels.model.robust`)
    scales: Sequence[float],
) -> Callable[[], Sums]:
    """Return a function that computes energies and changes of D, and the weights for D and slopes.

    An edge contributes α g Φ(r) + β g Φ(|Δv|) + γ g Φ(ΔD), each with its own contrast δ, with
    Φ(s) = 2s²/(1 + √(1 + s²/δ²)) and its half-quadratic form b s² + δ²(b + 1/b − 2)
    (`tisfm.kernels.solve.weight_update`). An anchor contributes w ψ(D − D*), where
    ψ(s) = 2s²/(1 + √(1 + s²/σ²)).
    """
    tensor, weights = arrays
    partial = block_sums(grid, 4)
    count = 0 if constraints is None else constraints.shape[0] // 3
    squared_contrasts = [contrast * contrast for contrast in (*contrasts, anchor_scale)]
    launch = _update[grid.lanes].bind(
        rho if constraints is None else constraints,
        anchors,
        edges,
        rho,
        half_h,
        *stiffness,
        # With infinite δ, b is 1 and its penalty is 0.
        *(
            value
            for square in squared_contrasts
            for value in (1.0 / square, _zero_if_infinite(square))
        ),
        *scale_pairs(scales or (np.inf,)),
        count,
        grid.is_serial,
        -(-grid.height // BAND_ROWS),
        weights,
        tensor,
        previous,
        partial,
    )

    def run() -> Sums:
        launch()
        energy, half_quadratic, change, size = add_blocks(partial)
        return Sums(
            energy=float(energy),
            half_quadratic=float(half_quadratic),
            change=float(np.sqrt(change)),
            size=float(np.sqrt(size)),
        )

    return run


def _zero_if_infinite(square: float) -> float:
    return square if np.isfinite(square) else 0.0


@lane_kernel
def _update(
    terms: LaneArray(3),  # (3 count, H+2, S+2)
    anchors: LaneArray(3),  # (2, H+2, S+2)
    edges: LaneArray(3),  # (2, H+2, S+2)
    rho: LaneArray(3),  # (3, H+2, S+2)
    half_h: ti.f32,
    alpha: ti.f32,
    beta: ti.f32,
    gamma: ti.f32,
    inverse_slope: ti.f32,
    slope_square: ti.f32,
    inverse_crease: ti.f32,
    crease_square: ti.f32,
    inverse_jump: ti.f32,
    jump_square: ti.f32,
    inverse_anchor: ti.f32,
    anchor_square: ti.f32,
    inverse_scale0: ti.f32,
    scale0: ti.f32,
    inverse_scale1: ti.f32,
    scale1: ti.f32,
    count: ti.template(),
    is_serial: ti.template(),
    bands: ti.i32,
    weights: LaneArray(3),  # (6, H+2, S+2), in place
    tensor: LaneArray(3),  # (3, H+2, S+2), in place
    previous: LaneArray(3),  # (1, H+2, S+2), in place
    partial: SumArray(3),  # (H, blocks, 4)
):
    height = rho.shape[1] - 2
    blocks = partial.shape[1]
    if ti.static(lane_count(rho) == 1):
        for index in range(height * blocks):
            stride = rho.shape[2] & INDEX_MASK
            starts = ti.static(component_starts(rho, max(WEIGHTS, 3 * count)))
            penalties = ti.static(
                ((alpha, inverse_slope, slope_square), (beta, inverse_crease, crease_square),
                 (gamma, inverse_jump, jump_square))
            )  # fmt: skip
            scales = ti.static(
                (
                    (inverse_anchor, anchor_square),
                    ((inverse_scale0, scale0), (inverse_scale1, scale1)),
                )
            )
            _update_block(
                terms, anchors, edges, rho, half_h, penalties, scales, count, weights, tensor,
                previous, partial, stride, starts, index // blocks, index % blocks,
            )  # fmt: skip
    else:
        chunk = ti.static(1 if is_serial else CHUNK)
        ti.loop_config(serialize=is_serial)
        for task in range(chunk * bands):
            if task % chunk == 0:
                band = task // chunk
                stride = rho.shape[2] & INDEX_MASK
                starts = ti.static(component_starts(rho, max(WEIGHTS, 3 * count)))
                penalties = ti.static(
                    ((alpha, inverse_slope, slope_square), (beta, inverse_crease, crease_square),
                     (gamma, inverse_jump, jump_square))
                )  # fmt: skip
                scales = ti.static(
                    (
                        (inverse_anchor, anchor_square),
                        ((inverse_scale0, scale0), (inverse_scale1, scale1)),
                    )
                )
                for row in range(
                    first_row(band, height, bands), first_row(band + 1, height, bands)
                ):
                    for block in range(blocks):
                        _update_block(
                            terms, anchors, edges, rho, half_h, penalties, scales, count, weights,
                            tensor, previous, partial, stride, starts, row, block,
                        )  # fmt: skip
                    # The first column of a strip reads its western weight from the halo: the
                    # eastern weight of the neighbouring strip's last column.
                    for weight_index in range(3):
                        refresh_halo(weights, 2 * weight_index, row + 1)


@ti.func
def _update_block(
    terms: ti.template(), anchors: ti.template(), edges: ti.template(), rho: ti.template(), half_h,
    penalties: ti.template(), scales: ti.template(), count: ti.template(), weights: ti.template(),
    tensor: ti.template(), previous: ti.template(), partial: ti.template(), stride,
    starts: ti.template(), row, block,
):  # fmt: skip
    """Update one block of a row."""
    y, strip = row + 1, rho.shape[2] - 2
    zero = 0.0 * rho[0, y, 1]
    energy, half_energy, change, size = zero, zero, zero, zero
    for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
        i = (y * stride + position + 1) & INDEX_MASK
        center = ti.static([bind(element(rho, i + starts[k])) for k in range(COMPONENTS)])
        depth = center[0]
        a, b, c = load(tensor, i), load(tensor, i + starts[1]), load(tensor, i + starts[2])
        half_energy += (a * depth + 2.0 * b) * depth + c
        value, sums = ti.static(_data_at(terms, anchors, scales, count, starts, depth, i))
        energy += value
        for k in ti.static(range(COMPONENTS)):
            store(tensor, i + starts[k], sums[k])
        for side in ti.static(range(2)):  # east, south
            g = load(edges, i + starts[side])
            other_index = i + 1 + side * (stride - 1)
            neighbour = ti.static(
                [bind(element(rho, other_index + starts[k])) for k in range(COMPONENTS)]
            )
            squares = ti.static(_squares(center, neighbour, side, half_h))
            for weight_index in ti.static(range(3)):
                stiffness, inverse, squared = ti.static(penalties[weight_index])
                index = i + starts[2 * weight_index + side]
                square, old_weight = squares[weight_index], load(weights, index)
                full_weight = stiffness * g
                root = ti.sqrt(1.0 + inverse * square)
                factor = full_weight / (root * (1.0 + root))
                energy += 2.0 * square * (root * factor)
                difference = full_weight - old_weight
                half_energy += old_weight * square
                half_energy += squared * difference * difference / ti.max(old_weight, MIN_PIVOT)
                store(weights, index, factor * (1.0 + root))
        depth_change = depth - load(previous, i)
        change += depth_change * depth_change
        size += depth * depth
        store(previous, i, depth)
    for term, value in ti.static(enumerate((energy, half_energy, change, size))):
        store_sum(partial, row, block, term, value, ti.static(lane_count(rho)))


def _data_at(
    terms: Any, anchors: Any, scales: tuple, count: int, starts: list, depth: Any, i: Any
) -> tuple[Any, list]:
    """Return the energy of a pixel's data, and (A, B, C) of their half-quadratic form."""
    (inverse, squared), robust = scales
    weight, target = (bind(element(anchors, i + starts[k])) for k in range(2))
    distance = bind(depth - target)
    square = bind(distance * distance)
    root = bind(ti.sqrt(1.0 + inverse * square))
    factor = bind(weight / (root * (1.0 + root)))
    trust = bind(factor * (1.0 + root))  # w ω
    energy = 2.0 * square * (root * factor)
    # σ²(ω + 1/ω − 2) = σ²(1 − ω)(1/ω − 1)
    penalty = squared * (weight - trust) * (root - 1.0)
    quadratic = [trust, 0.0 - trust * target, trust * target * target + penalty]
    if count:
        entries = [bind(element(terms, i + starts[k])) for k in range(3 * count)]
        lines = [(entries[3 * k], 0.0, entries[3 * k + 2]) for k in range(count)]
        value, sums = robust_data(terms_of(lines), list(robust), depth, 0.0)
        energy = energy + value
        quadratic = [total + sums[k] for total, k in zip(quadratic, (0, 3, 5), strict=True)]
    return bind(energy), [bind(entry) for entry in quadratic]


def _squares(center: list, neighbour: list, side: int, half_h: Any) -> list:
    """Return r², |Δv|² and ΔD² of an edge; `side` is 0 for east, 1 for south."""
    step, *slope_changes = (bind(end - start) for end, start in zip(neighbour, center, strict=True))
    slope_error = bind(step - half_h * (center[1 + side] + neighbour[1 + side]))
    return [
        bind(slope_error * slope_error),
        bind(slope_changes[0] * slope_changes[0] + slope_changes[1] * slope_changes[1]),
        bind(step * step),
    ]
