"""Second-order smoothness of inverse depth: its energy, its weights and its linear system.

The unknowns are (D, v₁, v₂), (3, H, W): inverse depth, and its slopes to the east and south.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.reference.smoothness import aubert

Array = np.ndarray  # of float64

# Slices of the two pixels of every edge, west and east, north and south.
_ENDS = ((np.s_[..., :-1], np.s_[..., 1:]), (np.s_[..., :-1, :], np.s_[..., 1:, :]))


@dataclass(frozen=True, kw_only=True)
class SecondOrder:
    """The smoothness Σ_edges α g Φ(r) + β g Φ(|Δv|) + γ g Φ(ΔD), r = ΔD − h (v_p + v_N)/2."""

    alpha: float
    beta: float
    gamma: float = 0.0
    contrasts: tuple[float, float, float] = (np.inf, np.inf, np.inf)  # δ of r, |Δv| and ΔD
    spacing: float = 1.0  # h
    edges: Array | None = None  # (2, H, W), g of the eastern and southern edges; None for 1

    def open(self, height: int, width: int) -> Array:
        """Return g, 0 at edges across the border: (2, H, W)."""
        edges = np.ones((2, height, width)) if self.edges is None else self.edges.copy()
        edges[0, :, -1] = edges[1, -1] = 0
        return edges

    def stiffness(self) -> Array:  # α, β and γ, (3, 1, 1, 1)
        return np.array([self.alpha, self.beta, self.gamma])[:, None, None, None]


def second_order_measures(rho: Array, spacing: float) -> Array:
    """Return r, |Δv| and ΔD of the eastern and southern edges, (3, 2, H, W), 0 at the border."""
    measures = np.zeros((3, 2, *rho.shape[1:]))
    for side, (near, far) in enumerate(_ENDS):
        measures[:, side][near] = _of_edges(rho[near], rho[far], 1 + side, spacing)
    return measures


def _of_edges(near: Array, far: Array, slope: int, spacing: float) -> Array:
    """Return r, |Δv| and ΔD between neighbours, along the axis of a slope."""
    step, first, second = far - near
    slope_error = step - spacing * (near[slope] + far[slope]) / 2
    return np.stack([slope_error, np.hypot(first, second), step])


def second_order_energy(rho: Array, smoothness: SecondOrder) -> float:
    measures = second_order_measures(rho, smoothness.spacing)
    penalties = [aubert(s, d) for s, d in zip(measures, smoothness.contrasts, strict=True)]
    return float((smoothness.stiffness() * smoothness.open(*rho.shape[1:]) * penalties).sum())


def second_order_weights(rho: Array, smoothness: SecondOrder) -> Array:
    """Return a = α g b of r, b = β g b of |Δv| and c = γ g b of ΔD, (3, 2, H, W)."""
    measures = second_order_measures(rho, smoothness.spacing)
    contrasts = np.array(smoothness.contrasts)[:, None, None, None]
    b = 1 / np.sqrt(1 + (measures / contrasts) ** 2)
    return smoothness.stiffness() * smoothness.open(*rho.shape[1:]) * b


def second_order_half_quadratic(rho: Array, weights: Array, smoothness: SecondOrder) -> float:
    """Return the half-quadratic form of the smoothness, with weights of `second_order_weights`."""
    measures = second_order_measures(rho, smoothness.spacing)
    full_weights = smoothness.stiffness() * smoothness.open(*rho.shape[1:])
    total = (weights * measures**2).sum()
    for weight, full, contrast in zip(weights, full_weights, smoothness.contrasts, strict=True):
        if np.isfinite(contrast):
            open_edges = full > 0
            b = weight[open_edges] / full[open_edges]
            total += (full[open_edges] * contrast**2 * (1 - b) ** 2 / b).sum()
    return float(total)


def anchor_energy(depth: Array, weight: Array, target: Array, scale: float) -> float:
    """Return Σ w ψ(D − D*), ψ(s) = 2σ²(√(1 + s²/σ²) − 1)."""
    return float((weight * aubert(depth - target, scale)).sum())


def anchor_tensor(depth: Array, weight: Array, target: Array, scale: float) -> Array:
    """Return (A, B, C) of the half-quadratic form of the anchors, (3, H, W)."""
    trust = 1 / np.sqrt(1 + ((depth - target) / scale) ** 2)
    penalty = scale**2 * (1 - trust) ** 2 / trust if np.isfinite(scale) else 0 * trust
    return weight * np.array([trust, -trust * target, trust * target**2 + penalty])


def line_tensor(
    terms: Sequence[Array], depth: Array, scales: Sequence[float]
) -> tuple[float, Array]:
    """Return the energy, and (A, B, C), (3, H, W), of constraints p D + c = 0.

    `terms` are (k, 2, H, W): p and c of the k constraints of each term. `scales` are as for
    `bench.reference.robust_tensor`.
    """
    energy, total = 0.0, np.zeros((3, *depth.shape))
    for term, scale in zip(terms, scales, strict=True):
        p, c = term[:, 0], term[:, 1]
        q = ((p * depth + c) ** 2).sum(axis=0)
        weight = 1 / np.sqrt(1 + q / scale)
        energy += float((2 * q / (1 + np.sqrt(1 + q / scale))).sum())
        total += weight * np.array([(p * p).sum(axis=0), (p * c).sum(axis=0), (c * c).sum(axis=0)])
        if np.isfinite(scale):
            total[2] += scale * (1 - weight) ** 2 / weight
    return energy, total


def second_order_system(tensor: Array, weights: Array, spacing: float) -> tuple[Array, Array]:
    """Return matrix and right-hand side of all pixels; the unknowns have the order of the array ρ.

    `tensor` is (A, B, C), `weights` come from `second_order_weights`.
    """
    _, height, width = tensor.shape
    count = height * width
    pixel = np.arange(count).reshape(height, width)
    matrix = np.zeros((3 * count, 3 * count))
    matrix[pixel, pixel] = tensor[0]
    for side, (down, across) in enumerate([(0, 1), (1, 0)]):
        for y, x in np.ndindex(height - down, width - across):
            a, b, c = weights[:, side, y, x]
            near, far = pixel[y, x], pixel[y + down, x + across]
            slopes = [(1 + side) * count + near, (1 + side) * count + far]
            forms = [(a, [near, far, *slopes], [-1, 1, -spacing / 2, -spacing / 2])]
            forms += [(b, [k * count + near, k * count + far], [-1, 1]) for k in (1, 2)]
            forms += [(c, [near, far], [-1, 1])]
            for weight, unknowns, row in forms:
                matrix[np.ix_(unknowns, unknowns)] += weight * np.outer(row, row)
    right = np.zeros(3 * count)
    right[:count] = -tensor[1].ravel()
    return matrix, right


def second_order_residual(
    tensor: Array, weights: Array, rho: Array, *, spacing: float, source: Array | None = None
) -> Array:
    """Return the right-hand side minus the left-hand side of the system, (3, H, W), matrix-free.

    `source`, (3, H, W), replaces the right-hand side (−B, 0, 0).
    """
    residual = np.zeros_like(rho) if source is None else source.astype(rho.dtype)
    if source is None:
        residual[0] -= tensor[1]
    residual[0] -= tensor[0] * rho[0]
    for side, (near, far) in enumerate(_ENDS):
        a, b, c = weights[:, side][near]
        step, first, second = rho[far] - rho[near]
        slope = 1 + side
        slope_error = a * (step - spacing / 2 * (rho[near][slope] + rho[far][slope]))
        pull = np.stack([slope_error + c * step, b * first, b * second])
        residual[near] += pull
        residual[far] -= pull
        for end in (near, far):
            residual[end][slope] += spacing / 2 * slope_error
    return residual


def second_order_matrices(tensor: Array, weights: Array, spacing: float) -> Array:
    """Return the 3×3 matrix of every pixel with its neighbours fixed: (3, 3, H, W)."""
    matrices = np.zeros((3, 3, *tensor.shape[1:]))
    matrices[0, 0] = tensor[0]
    for side, ends in enumerate(_ENDS):
        a, b, c = weights[:, side][ends[0]]
        slope = 1 + side
        for end, sign in zip(ends, (1, -1), strict=True):
            own = matrices[end]
            own[0, 0] += a + c
            own[1, 1] += b
            own[2, 2] += b
            own[slope, slope] += a * spacing**2 / 4
            own[0, slope] += sign * a * spacing / 2
            own[slope, 0] += sign * a * spacing / 2
    return matrices


def second_order_sweep(
    tensor: Array,
    weights: Array,
    rho: Array,
    *,
    spacing: float,
    relaxation: float = 1.0,
    source: Array | None = None,
) -> None:
    """Gauss–Seidel over red pixels, then black; `rho` is modified in place.

    `source`, (3, H, W), replaces the right-hand side (−B, 0, 0).
    """
    matrices = np.moveaxis(second_order_matrices(tensor, weights, spacing), (0, 1), (2, 3))
    rows, columns = np.indices(rho.shape[1:])
    for color in (0, 1):
        own = (rows + columns) % 2 == color
        residual = second_order_residual(tensor, weights, rho, spacing=spacing, source=source)
        step = np.linalg.solve(matrices[own], residual[:, own].T[..., None])
        rho[:, own] += relaxation * step[..., 0].T


def minimise_second_order(
    anchors: Array,  # (2, H, W): w and D*
    rho: Array,  # (3, H, W)
    smoothness: SecondOrder,
    *,
    anchor_scale: float,
    iterations: int,
    terms: Sequence[Array] = (),  # as for `line_tensor`
    scales: Sequence[float] = (),
) -> list[float]:
    """Run half-quadratic iterations with exact solutions; `rho` is modified in place.

    Return the energy before, and after every iteration.
    """
    energies = []
    for step in range(iterations + 1):
        data, form = line_tensor(terms, rho[0], scales)
        data += anchor_energy(rho[0], anchors[0], anchors[1], anchor_scale)
        energies.append(data + second_order_energy(rho, smoothness))
        if step < iterations:
            tensor = form + anchor_tensor(rho[0], anchors[0], anchors[1], anchor_scale)
            weights = second_order_weights(rho, smoothness)
            matrix, right = second_order_system(tensor, weights, smoothness.spacing)
            # A slope across an image 1 px wide has no cost: a tiny weight keeps it at 0.
            regularisation = 1e-12 * matrix.diagonal().max() * np.eye(len(matrix))
            solution = np.linalg.solve(matrix + regularisation, right)
            rho[...] = solution.reshape(rho.shape)
    return energies
