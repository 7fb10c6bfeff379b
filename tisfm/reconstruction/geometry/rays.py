"""Rays of image points, points nearest to several rays, and cross-product matrices."""

import numpy as np

from tisfm.camera import Camera


def pinhole_rays(
    points: np.ndarray,  # (N, 2) float64: (x, y), px
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],  # height and width of the frames, px
) -> np.ndarray:
    """Return the rays of image points of a pinhole camera, (N, 3) with z = 1."""
    return np.column_stack(
        [(points - np.array(camera.center_for(*shape))) / camera.focal, np.ones(len(points))]
    )


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """Return vectors, (N, 3), divided by their lengths."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def nearest_point_equations(
    index: np.ndarray,  # (N,) int array: the point of each ray
    # rays, centres: (N, 3) float64, unit directions and camera centres of the rays, in the world
    rays: np.ndarray,
    centres: np.ndarray,
    count: int,  # number of points P
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of the points nearest to their rays.

    Returns a matrix, (P, 3, 3) float64, and a vector, (P, 3) float64. If the rays of a point are
    parallel, the smallest eigenvalue of its matrix is 0.
    """
    # Projections to the planes perpendicular to the rays
    projections = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    matrix, vector = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(matrix, index, projections)
    np.add.at(vector, index, np.einsum("nkl,nl->nk", projections, centres))
    return matrix, vector


def cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Return [v]× of vectors, (N, 3, 3), so that [v]× w is v × w."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [(zero, -z, y), (z, zero, -x), (-y, x, zero)]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
