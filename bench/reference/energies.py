"""The energy of a quadratic data term with smoothness, and its half-quadratic form."""

import numpy as np

from bench.reference.data import data_energy
from bench.reference.smoothness import Smoothness, smoothness_energy


def energy(
    tensor: np.ndarray, motion: np.ndarray, rho: np.ndarray, alpha: float, smoothness: Smoothness
) -> float:
    """Return the energy (eq. 6, 20): the quadratic data term plus α times the smoothness."""
    return data_energy(tensor, motion, rho) + alpha * smoothness_energy(rho, smoothness)


def half_quadratic_energy(
    tensor: np.ndarray,
    motion: np.ndarray,
    rho: np.ndarray,
    weights: np.ndarray,
    alpha: float,
    smoothness: Smoothness,
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
