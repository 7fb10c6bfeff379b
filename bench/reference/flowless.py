"""Rigid motions without image motion: fields of ρ̂ with Gρ̂ = 0, and the best multiple of each."""

import numpy as np

from bench.reference.smoothness import differences


def flowless_fields(motion: np.ndarray) -> np.ndarray:
    """Return the smooth fields without image motion, (4, 6, H, W), or (1, 3, H, W).

    They are τ along the line of sight, and each component of ω with the τ that cancels its image
    motion.

    Parameters
    ----------
    motion : (2, n, H, W) array
        G of 6 or 3 components (`bench.reference.motion_matrix`).
    """
    x, y = -motion[0, 2], -motion[1, 2]
    one, zero = np.ones_like(x), np.zeros_like(x)
    along = [x, y, one, zero, zero, zero]
    about_x = [x * y, 1 + y * y, zero, one, zero, zero]
    about_y = [-1 - x * x, -x * y, zero, zero, one, zero]
    about_z = [y, -x, zero, zero, zero, one]
    if motion.shape[1] == 6:
        return np.array([along, about_x, about_y, about_z])
    return np.array([along[:3]])


def minimise_over_flowless(
    motion: np.ndarray, weights: np.ndarray, rho: np.ndarray, alpha: float
) -> None:
    """Add to ρ̂ the multiple of each field that minimises the energy; `rho` is modified in place.

    Only α Σ b Δρ̂² depends on these multiples, the data terms do not. `weights` are b, (2n, H, W).
    """
    fields = flowless_fields(motion)
    b = alpha * weights.reshape(2, *rho.shape)
    steps = np.stack([np.stack(differences(field)) for field in fields])
    matrix = np.einsum("icnyx,cnyx,jcnyx->ij", steps, b, steps)
    vector = -np.einsum("icnyx,cnyx,cnyx->i", steps, b, np.stack(differences(rho)))
    rho += np.einsum("i,inyx->nyx", np.linalg.lstsq(matrix, vector, rcond=None)[0], fields)
