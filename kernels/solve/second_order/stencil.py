"""The local system of a pixel, as code that is generated while a kernel is compiled."""

from typing import Any

import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import element

COMPONENTS = 3  # D, v₁, v₂
WEIGHTS = 6  # a, b and c, each for the eastern and the southern edge


def center_at(rho: Any, starts: list, i: Any) -> list:
    """Return D, v₁ and v₂ of the pixel with index i (see `element`)."""
    return [bind(element(rho, i + starts[k])) for k in range(COMPONENTS)]


def edges_at(weights: Any, starts: list, stride: Any, i: Any) -> list:
    """Return a, b and c of the edges of a pixel, each a list of E, W, S, N."""
    edge_indices = ((0, i), (0, i - 1), (1, i), (1, i - stride))
    return [
        [bind(element(weights, index + starts[2 * term + side])) for side, index in edge_indices]
        for term in range(3)
    ]


def stiffness_at(tensor: Any, edges: list, starts: list, i: Any, half_h: Any, spread: Any) -> list:
    """Return the stiffness of v₁ and v₂ of a pixel without the part of r: Σ b with a lower bound.

    The data of a coarse pixel lie away from its centre, so they determine the slope with the
    precision A times the variance `spread`. The stiffness including the part of r is at least that.
    """
    a_weights, b_weights, _ = edges
    b_sum = bind(b_weights[0] + b_weights[1] + b_weights[2] + b_weights[3])
    data_precision = bind(spread * element(tensor, i + starts[0]))
    return [
        bind(
            ti.max(
                b_sum, data_precision - half_h * half_h * (a_weights[side] + a_weights[side + 1])
            )
        )
        for side in (0, 2)
    ]


def residual_at(
    tensor: Any,
    edges: list,
    stiffness: list,
    source: Any,
    starts: list,
    stride: Any,
    rho: Any,
    center: list,
    i: Any,
    half_h: Any,
) -> list:
    """Return the right-hand side minus the left-hand side for D, v₁ and v₂.

    `half_h` is h/2, `stiffness` is from `stiffness_at`. Without `source`, the right-hand side is
    (−B, 0, 0), with B from the tensor.
    """
    depth, *slopes = center
    a_weights, b_weights, c_weights = edges
    neighbours = (i + 1, i - 1, i + stride, i - stride)
    steps = [bind(element(rho, index + starts[0]) - depth) for index in neighbours]
    depth_residual = 0.0 - element(tensor, i + starts[0]) * depth
    if source is None:
        depth_residual = depth_residual - element(tensor, i + starts[1])
    else:
        depth_residual = depth_residual + element(source, i + starts[0])
    for weight, step in zip(c_weights, steps, strict=True):
        depth_residual = depth_residual + weight * step
    neighbour_slopes = [
        [bind(element(rho, index + starts[1 + k])) for index in neighbours] for k in range(2)
    ]
    residual = []
    for k, slope in enumerate(slopes):
        ahead, behind = 2 * k, 2 * k + 1
        forward = bind(
            a_weights[ahead] * (steps[ahead] - half_h * (slope + neighbour_slopes[k][ahead]))
        )
        backward = bind(
            a_weights[behind] * (steps[behind] + half_h * (slope + neighbour_slopes[k][behind]))
        )
        depth_residual = depth_residual + forward + backward
        slope_residual = half_h * (forward - backward)
        for weight, other in zip(b_weights, neighbour_slopes[k], strict=True):
            slope_residual = slope_residual + weight * (other - slope)
        b_sum = bind(b_weights[0] + b_weights[1] + b_weights[2] + b_weights[3])
        slope_residual = slope_residual - (stiffness[k] - b_sum) * slope
        if source is not None:
            slope_residual = slope_residual + element(source, i + starts[1 + k])
        residual.append(bind(slope_residual))
    return [bind(depth_residual), *residual]


def solve_at(
    tensor: Any, edges: list, stiffness: list, starts: list, residual: list, i: Any, half_h: Any,
    floors: tuple,
) -> list:  # fmt: skip
    """Return the step that makes the residual of a pixel zero, given its neighbours.

    v₁ and v₂ are coupled with D, but not with each other. After their elimination, D has the pivot
    A + Σc + Σ_k p_k, with

        p = (h² a a' + (a + a') s) / (h²/4 (a + a') + s),

    a and a' the weights of the two edges along an axis, and s the stiffness of its slope. This is a
    sum of positive numbers, so no digits cancel. `floors` are added to the pivots of D and of v,
    whose terms may all be zero.
    """
    a_weights, _, c_weights = edges
    pivot = (
        element(tensor, i + starts[0])
        + c_weights[0]
        + c_weights[1]
        + c_weights[2]
        + c_weights[3]
        + floors[0]
    )
    right = residual[0]
    inverses, couplings = [], []
    for k in range(2):
        ahead, behind = a_weights[2 * k], a_weights[2 * k + 1]
        weight_sum = bind(ahead + behind)
        slope_stiffness = bind(stiffness[k] + floors[1])
        inverse = bind(1.0 / (half_h * half_h * weight_sum + slope_stiffness))
        coupling = bind(half_h * (ahead - behind) * inverse)
        pivot = (
            pivot
            + (4.0 * half_h * half_h * ahead * behind + weight_sum * slope_stiffness) * inverse
        )
        right = right - coupling * residual[1 + k]
        inverses.append(inverse)
        couplings.append(coupling)
    step = bind(right / bind(pivot))
    return [
        step,
        *(
            bind(inverse * entry - coupling * step)
            for inverse, coupling, entry in zip(inverses, couplings, residual[1:], strict=True)
        ),
    ]
