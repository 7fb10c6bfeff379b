"""The data term: image motion, motion tensors and their robust weights."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.reference.epipolar import rays
from tisfm.camera import Camera

Array = np.ndarray  # of float64


def motion_matrix(camera: Camera, height: int, width: int, components: int) -> Array:
    """Return G, (2, components, H, W): eq. 2 in scaled unknowns.

    6 components are rigid motion, 3 translation, 2 the flow itself, 1 the displacement along a
    known line.
    """
    x, y, one = rays(camera, height, width)
    zero = np.zeros_like(x)
    rigid = np.array(
        [[one, zero, -x, -x * y, 1 + x * x, -y], [zero, one, -y, -(1 + y * y), x * y, x]]
    )
    return rigid[:, :components]


def flow(motion: Array, rho: Array) -> Array:
    """Return (u, v), (2, H, W): eq. 25, Gρ̂."""
    return np.einsum("ckyx,kyx->cyx", motion, rho)


def brightness_tensor(gradients: tuple[Array, Array, Array], flow0: Array, mask: Array) -> Array:
    """Return J11, J12, J22, j1, j2, J_tt, (6, H, W): eq. 3 squared, for the total flow.

    `flow0`, (2, H, W), is the flow that warped frame 1 of the gradients.
    """
    ix, iy, it = gradients
    c = it - ix * flow0[0] - iy * flow0[1]
    return mask * np.array([ix * ix, ix * iy, iy * iy, c * ix, c * iy, c * c])


def constancy_constraints(
    gradients: tuple[Array, Array, Array],
    flow0: Array,
    mask: Array,
    *,
    brightness: float,
    gradient: float,
    normalization: float | None,
) -> list[Array]:
    """Return (p, q, c) of the constraints p u + q v + c = 0 of each term with a positive weight.

    Brightness has one constraint, (1, 3, H, W), its gradient two, (2, 3, H, W). `gradients` have a
    halo of 2 px; `flow0`, (2, H, W), is the flow that warped their frame 1. With normalisation,
    each squared constraint is divided by |∇I|² + ζ².
    """

    def constraint(weight: float, ix: Array, iy: Array, it: Array) -> Array:
        squared = weight * mask
        if normalization is not None:
            squared = squared / (ix**2 + iy**2 + normalization**2 + 1e-12)
        return np.sqrt(squared) * np.array([ix, iy, it - ix * flow0[0] - iy * flow0[1]])

    ix, iy, it = gradients
    terms = []
    if brightness > 0:
        inner = np.s_[2:-2, 2:-2]
        terms.append(constraint(brightness, ix[inner], iy[inner], it[inner])[None])
    if gradient > 0:
        of_x = _five_tap(ix, 1), _five_tap(iy, 1), _five_tap(it, 1)
        of_y = _five_tap(iy, 1), _five_tap(iy, 0), _five_tap(it, 0)
        terms.append(np.stack([constraint(gradient, *of_x), constraint(gradient, *of_y)]))
    return terms


def constancy_tensors(*arguments: Any, **weights: Any) -> list[Array]:
    """Return the motion tensors, (6, H, W), of `constancy_constraints`."""
    return tensors_of(constancy_constraints(*arguments, **weights))


def tensors_of(terms: Sequence[Array]) -> list[Array]:
    """Return J11, J12, J22, j1, j2, J_tt, (6, H, W), of terms of constraints, (k, 3, H, W)."""
    pairs = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    return [np.array([(term[:, i] * term[:, j]).sum(axis=0) for i, j in pairs]) for term in terms]


def _five_tap(image: Array, axis: int) -> Array:
    """Return the derivative along an axis by (1, −8, 0, 8, −1)/12, without the halo of 2 px."""
    near = np.roll(image, -1, axis) - np.roll(image, 1, axis)
    far = np.roll(image, -2, axis) - np.roll(image, 2, axis)
    return (8 * near - far)[2:-2, 2:-2] / 12


def robust_tensor(
    terms: Sequence[Array], motion: Array, rho: Array, scales: Sequence[float]
) -> Array:
    """Return Σ w J, (6, H, W), with w = 1/√(1 + q/s), q the quadratic form and s the scale of J.

    Its J_tt includes the penalty s(w + 1/w − 2), so that its quadratic form is the half-quadratic
    data term.
    """
    total = np.zeros_like(terms[0])
    for term, scale in zip(terms, scales, strict=True):
        weight = 1 / np.sqrt(1 + residual(term, motion, rho) / scale)
        total += weight * term
        if np.isfinite(scale):
            total[5] += scale * (1 - weight) ** 2 / weight
    return total


def robust_energy(
    terms: Sequence[Array], motion: Array, rho: Array, scales: Sequence[float]
) -> float:
    """Return Σ 2s(√(1 + q/s) − 1) over pixels and terms (Charbonnier)."""
    total = 0.0
    for term, scale in zip(terms, scales, strict=True):
        q = residual(term, motion, rho)
        total += float((2 * q / (1 + np.sqrt(1 + q / scale))).sum())
    return total


def residual(tensor: Array, motion: Array, rho: Array) -> Array:
    """Return (u,v) J (u,v)ᵀ + 2 jᵀ(u,v) + J_tt, (H, W): a square, so at least 0."""
    return np.maximum(_quadratic_form(tensor, motion, rho), 0)


def data_energy(tensor: Array, motion: Array, rho: Array) -> float:
    """Return Σ (u,v) J (u,v)ᵀ + 2 jᵀ(u,v) + J_tt."""
    return float(_quadratic_form(tensor, motion, rho).sum())


def _quadratic_form(tensor: Array, motion: Array, rho: Array) -> Array:
    u, v = flow(motion, rho)
    j11, j12, j22, j1, j2, jtt = tensor
    return j11 * u * u + 2 * j12 * u * v + j22 * v * v + 2 * (j1 * u + j2 * v) + jtt
