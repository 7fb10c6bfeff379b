"""One rigid motion of the camera: every pixel moves along a line, by its inverse depth."""

import numpy as np

from tisfm.camera import Camera


def displacement(
    inverse_depth: np.ndarray, camera: Camera, rotation: np.ndarray, translation: np.ndarray
) -> np.ndarray:
    """Return the exact flow (u, v), (2, H, W), of pixels under P₁ = R P₀ + t.

    Parameters
    ----------
    inverse_depth : (H, W)
        D = f·d, px/frame for ‖t‖ = 1.
    """
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    ray = np.stack([(columns - cx) / camera.focal, (rows - cy) / camera.focal, np.ones_like(rows)])
    moved = np.einsum("ij,jyx->iyx", rotation, ray)
    moved += translation[:, None, None] * inverse_depth / camera.focal
    return camera.focal * (moved[:2] / moved[2] - ray[:2])


def along(
    terms: list[np.ndarray], flow: np.ndarray, direction: np.ndarray, inverse_depth: np.ndarray
) -> list[np.ndarray]:
    """Return each tensor as one of a flow (D, 0), for (u, v) = flow + (D − D₀)·direction.

    D₀ is `inverse_depth`, where `flow` was taken.
    """
    fixed = flow - inverse_depth * direction
    restricted = []
    for j11, j12, j22, j1, j2, jtt in terms:
        matrix = np.array([[j11, j12], [j12, j22]])
        vector = np.array([j1, j2])
        zero = np.zeros_like(j11)
        gradient = np.einsum("abyx,byx->ayx", matrix, fixed)
        square = np.einsum("ayx,abyx,byx->yx", direction, matrix, direction)
        linear = (direction * (gradient + vector)).sum(axis=0)
        constant = (fixed * (gradient + 2 * vector)).sum(axis=0) + jtt
        restricted.append(np.stack([square, zero, zero, linear, zero, constant]))
    return restricted
