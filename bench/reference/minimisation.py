"""The energy, and the half-quadratic algorithm (Table 1) within one linearisation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.reference.data import data_energy, robust_energy, robust_tensor
from bench.reference.linear_system import sweep_red_black
from bench.reference.smoothness import Smoothness, differences, edge_weights, smoothness_energy

Array = np.ndarray  # of float64


@dataclass(frozen=True)
class Minimisation:
    """Energies and relative changes of the half-quadratic iterations."""

    energies: list[float]
    half_quadratic: list[float]
    changes: list[float]
    converged: bool


def minimise(
    terms: Sequence[Array],
    motion: Array,
    rho: Array,
    *,
    alpha: float,
    smoothness: Smoothness,
    outer_iterations: int,
    sweeps: int,
    scales: Sequence[float] = (np.inf,),
    relaxation: float = 1.0,
    tolerance: float = 0.0,
    thorough: bool = False,
) -> Minimisation:
    """Run the half-quadratic algorithm (Table 1); `rho` is modified in place.

    `terms` are motion tensors, (6, H, W), with the scales of `robust_tensor`. With `thorough`, the
    energy is also minimised over rigid motions without image motion after the sweeps. Iterations
    stop when the last change is at most `tolerance`, so ρ̂ may be further from the minimum.
    Only the solver of tisfm has multigrid and an estimate of the remaining error.
    """
    energies: list[float] = []
    half_quadratic: list[float] = []
    changes: list[float] = []
    for _ in range(outer_iterations):
        previous_rho = rho.copy()
        weights = edge_weights(rho, smoothness)
        tensor = robust_tensor(terms, motion, rho, scales)
        for _ in range(sweeps):
            sweep_red_black(tensor, motion, weights, rho, alpha=alpha, relaxation=relaxation)
        if thorough and len(rho) >= 3:
            minimise_over_flowless(motion, weights, rho, alpha)
        data = robust_energy(terms, motion, rho, scales)
        energies.append(data + alpha * smoothness_energy(rho, smoothness))
        half_quadratic.append(
            half_quadratic_energy(tensor, motion, rho, weights, alpha, smoothness)
        )
        change, size = np.linalg.norm(rho - previous_rho), np.linalg.norm(rho)
        changes.append(float(change / size) if size > 0 else 0.0)
        if change <= tolerance * size:
            return Minimisation(energies, half_quadratic, changes, True)
    return Minimisation(energies, half_quadratic, changes, False)


def flowless_fields(motion: Array) -> Array:
    """Return the smooth fields without image motion, (4, 6, H, W), or (1, 3, H, W).

    They are τ along the line of sight, and each component of ω with the τ that cancels its image
    motion.

    `motion`, (2, n, H, W), is G of 6 or 3 components (`bench.reference.motion_matrix`).
    """
    x, y = -motion[0, 2], -motion[1, 2]
    one, zero = np.ones_like(x), np.zeros_like(x)
    along_ray = [x, y, one, zero, zero, zero]
    about_x = [x * y, 1 + y * y, zero, one, zero, zero]
    about_y = [-1 - x * x, -x * y, zero, zero, one, zero]
    about_z = [y, -x, zero, zero, zero, one]
    if motion.shape[1] == 6:
        return np.array([along_ray, about_x, about_y, about_z])
    return np.array([along_ray[:3]])


def minimise_over_flowless(motion: Array, weights: Array, rho: Array, alpha: float) -> None:
    """Add to ρ̂ the multiple of each field that minimises the energy; `rho` is modified in place.

    Only α Σ b Δρ̂² depends on these multiples, the data terms do not. `weights` are b, (2n, H, W).
    """
    fields = flowless_fields(motion)
    b = alpha * weights.reshape(2, *rho.shape)
    steps = np.stack([np.stack(differences(field)) for field in fields])
    matrix = np.einsum("icnyx,cnyx,jcnyx->ij", steps, b, steps)
    vector = -np.einsum("icnyx,cnyx,cnyx->i", steps, b, np.stack(differences(rho)))
    rho += np.einsum("i,inyx->nyx", np.linalg.lstsq(matrix, vector, rcond=None)[0], fields)


def energy(tensor: Array, motion: Array, rho: Array, alpha: float, smoothness: Smoothness) -> float:
    """Return the energy (eq. 6, 20): the quadratic data term plus α times the smoothness."""
    return data_energy(tensor, motion, rho) + alpha * smoothness_energy(rho, smoothness)


def half_quadratic_energy(
    tensor: Array, motion: Array, rho: Array, weights: Array, alpha: float, smoothness: Smoothness
) -> float:
    """Return the half-quadratic form (eq. 8, 21) of `energy`: per edge g[bΔ² + δ²(b + 1/b − 2)]."""
    n, height, width = rho.shape
    edges = smoothness.open(height, width)
    scale = smoothness.stiffnesses(n) * edges
    b = np.where(scale > 0, weights.reshape(2, n, height, width) / np.where(scale > 0, scale, 1), 1)
    penalty = b * smoothness.squares(rho)
    if np.isfinite(smoothness.contrast):
        penalty = penalty + smoothness.contrast**2 * (1 - b) ** 2 / b
    if smoothness.joint:
        penalty = penalty[:, :1]
    return data_energy(tensor, motion, rho) + alpha * float((edges * penalty).sum())
