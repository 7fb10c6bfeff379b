"""The smoothness term: weights of the differences between neighbours."""

from dataclasses import dataclass

import numpy as np

Array = np.ndarray  # of float64


def aubert(difference: Array, contrast: float) -> Array:
    """Return Φ_δ(s) = 2δ²(√(1 + s²/δ²) − 1), written without its cancellation."""
    square = difference**2
    return 2 * square / (1 + np.sqrt(1 + square / contrast**2))


def differences(rho: Array) -> tuple[Array, Array]:
    """Return the eastern and southern differences (eq. 13), (n, H, W), 0 across the border."""
    east, south = np.zeros_like(rho), np.zeros_like(rho)
    east[:, :, :-1] = np.diff(rho, axis=2)
    south[:, :-1] = np.diff(rho, axis=1)
    return east, south


@dataclass(frozen=True, kw_only=True)
class Smoothness:
    contrast: float  # δ, px/frame
    stiffness: Array | None = None  # (n,), s_k; None for 1
    joint: bool = False  # whether all components of ρ̂ share one weight per edge
    edges: Array | None = None  # (2, H, W), g of the eastern and southern edges; None for 1

    def squares(self, rho: Array) -> Array:
        """Return s_kΔ²; if joint, their sum over k for every k: (2, n, H, W)."""
        squares = np.stack(differences(rho)) ** 2 * self.stiffnesses(len(rho))
        if self.joint:
            squares = np.broadcast_to(squares.sum(axis=1, keepdims=True), squares.shape)
        return squares

    def stiffnesses(self, components: int) -> Array:  # s_k, (n, 1, 1)
        values = np.ones(components) if self.stiffness is None else np.asarray(self.stiffness)
        return values[:, None, None]

    def open(self, height: int, width: int) -> Array:
        """Return g, 0 at edges across the border: (2, 1, H, W)."""
        edges = np.ones((2, height, width)) if self.edges is None else self.edges.copy()
        edges[0, :, -1] = edges[1, -1] = 0
        return edges[:, None]


def mean_step(frame: Array) -> float:
    """Return the mean |ΔI| between neighbours: the contrast of a frame."""
    steps = [np.abs(np.diff(np.asarray(frame, np.float64), axis=axis)).ravel() for axis in (0, 1)]
    return float(np.concatenate(steps).mean())


def image_edges(frame: Array, strength: float) -> Array:
    """Return g = c/(1 + κ|ΔI|/m), (2, H, W): m the mean of |ΔI|, c such that the mean of g is 1."""
    steps = np.abs(np.stack(differences(frame[None].astype(np.float64))))[:, 0]
    has_neighbour = np.ones(steps.shape, bool)
    has_neighbour[0, :, -1] = has_neighbour[1, -1] = False
    if not has_neighbour.any():
        return np.zeros(steps.shape)
    edges = has_neighbour / (1 + strength * steps / max(mean_step(frame), 1e-5))
    return edges / edges[has_neighbour].mean()


def edge_weights(rho: Array, smoothness: Smoothness) -> Array:
    """Return s_k g b (eq. 10, 14), (2n, H, W): n eastern edges, n southern ones."""
    b = 1 / np.sqrt(1 + smoothness.squares(rho) / smoothness.contrast**2)
    weights = smoothness.stiffnesses(len(rho)) * smoothness.open(*rho.shape[1:]) * b
    return weights.reshape(-1, *rho.shape[1:])


def smoothness_energy(rho: Array, smoothness: Smoothness) -> float:
    """Return Σ_edges g Σ_k Φ_δ(√s_k Δρ̂_k); if joint, Σ_edges g Φ_δ of the length of the vector."""
    penalty = aubert(np.sqrt(smoothness.squares(rho)), smoothness.contrast)
    if smoothness.joint:
        penalty = penalty[:, :1]
    return float((smoothness.open(*rho.shape[1:]) * penalty).sum())
