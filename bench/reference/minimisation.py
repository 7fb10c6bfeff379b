"""The half-quadratic algorithm (Table 1), within one linearisation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.reference.data import robust_energy, robust_tensor
from bench.reference.energies import half_quadratic_energy
from bench.reference.flowless import minimise_over_flowless
from bench.reference.linear_system import sweep_red_black
from bench.reference.smoothness import Smoothness, edge_weights, smoothness_energy


@dataclass(frozen=True)
class Minimisation:
    """Energies and relative changes of the half-quadratic iterations."""

    energies: list[float]
    half_quadratic: list[float]
    changes: list[float]
    converged: bool


def minimise(
    terms: Sequence[np.ndarray],
    motion: np.ndarray,
    rho: np.ndarray,
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
    stop by the last change in either case, so ρ̂ may be further from the minimum than `tolerance`.
    Only the solver of tisfm has multigrid and an estimate of the remaining error.
    """
    energies: list[float] = []
    half: list[float] = []
    changes: list[float] = []
    for _ in range(outer_iterations):
        before = rho.copy()
        weights = edge_weights(rho, smoothness)
        tensor = robust_tensor(terms, motion, rho, scales)
        for _ in range(sweeps):
            sweep_red_black(tensor, motion, weights, rho, alpha=alpha, relaxation=relaxation)
        if thorough and len(rho) >= 3:
            minimise_over_flowless(motion, weights, rho, alpha)
        data = robust_energy(terms, motion, rho, scales)
        energies.append(data + alpha * smoothness_energy(rho, smoothness))
        half.append(half_quadratic_energy(tensor, motion, rho, weights, alpha, smoothness))
        moved, size = np.linalg.norm(rho - before), np.linalg.norm(rho)
        changes.append(float(moved / size) if size > 0 else 0.0)
        if moved <= tolerance * size:
            return Minimisation(energies, half, changes, True)
    return Minimisation(energies, half, changes, False)
