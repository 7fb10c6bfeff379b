"""The normal equations of an adjustment, after the points were eliminated (Schur complement).

They have a prior of the zoom, and a term that keeps the scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags

from tisfm.reconstruction.calibration.bundle_residuals import BundleResiduals, BundleState
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.calibration.track_bundle import TrackBundle


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedEquations:
    """Normal equations of the camera's side, after the points were eliminated."""

    matrix: np.ndarray
    gradient: np.ndarray
    coupling: csr_matrix  # camera's side × points
    inverse_points: csr_matrix  # block diagonal
    point_gradient: np.ndarray

    def point_step(self, step: np.ndarray) -> np.ndarray:
        """Return the step of the points that belongs to a step of the camera's side."""
        return np.asarray(-self.inverse_points @ (self.point_gradient + self.coupling.T @ step))


def reduce_equations(
    bundle: TrackBundle,
    state: BundleState,
    linear: BundleResiduals,
    is_free: np.ndarray,  # (K,) bool: the free unknowns of the camera's side
    scale: float,
    damping: float = 0.0,
) -> ReducedEquations:
    """Return the normal equations of the camera's side, in units of the residuals' deviation."""
    weight = _weigh(linear, scale)
    weighted = linear.by_camera.T @ diags(np.repeat(weight, 2))
    matrix = (weighted @ linear.by_camera).toarray()
    gradient = weighted @ linear.residuals.ravel()
    _add_zoom_prior(matrix, gradient, state.zoom + state.removed_zoom, bundle.frames)
    _fix_scale(matrix, state.poses)
    coupling = (weighted @ linear.by_points).tocsr()[is_free]
    matrix, gradient = matrix[np.ix_(is_free, is_free)], gradient[is_free]
    matrix += damping * np.diag(np.diag(matrix))
    inverse_points = _inverse_point_blocks(bundle, linear, weight, damping)
    point_gradient = linear.by_points.T @ (np.repeat(weight, 2) * linear.residuals.ravel())
    eliminated = coupling @ inverse_points
    return ReducedEquations(
        matrix=matrix - multiply_by_columns(eliminated, coupling),
        gradient=gradient - eliminated @ point_gradient,
        coupling=coupling,
        inverse_points=inverse_points,
        point_gradient=point_gradient,
    )


def track_gradients(
    bundle: TrackBundle,
    linear: BundleResiduals,
    reduced: ReducedEquations,  # without damping
    is_free: np.ndarray,  # as for `reduce_equations`, and `scale`, too
    scale: float,
) -> csr_matrix:
    """Return what each track adds to the gradient of the camera's side, (K, P), without the prior.

    The points are eliminated, so a track counts with the residuals that its best point leaves.
    """
    rows = 2 * len(bundle.positions)
    weighted = np.repeat(_weigh(linear, scale), 2) * linear.residuals.ravel()
    of_tracks = csr_matrix(
        (weighted, np.repeat(bundle.indices, 2), np.arange(rows + 1)),
        shape=(rows, len(bundle.points)),
    )
    by_points = reduced.inverse_points @ (linear.by_points.T @ of_tracks)
    return (linear.by_camera[:, is_free].T @ of_tracks - reduced.coupling @ by_points).tocsr()


def multiply_by_columns(left: csr_matrix, right: csr_matrix) -> np.ndarray:
    """Return ``left @ right.T``, (K, K), of two (K, P) matrices.

    Where many columns have many entries, products of dense parts are faster.
    """
    counts = [np.diff(values.tocsc().indptr) for values in (left, right)]
    operations = int(counts[0].astype(np.int64) @ counts[1])
    if operations < CALIBRATION.min_dense_operations:
        return np.asarray((left @ right.T).toarray())
    lefts, rights, step = left.tocsc(), right.tocsc(), CALIBRATION.dense_columns
    product = np.zeros((left.shape[0], right.shape[0]))
    for begin in range(0, left.shape[1], step):
        part = slice(begin, begin + step)
        product += lefts[:, part].toarray() @ rights[:, part].toarray().T
    return product


def _weigh(linear: BundleResiduals, scale: float) -> np.ndarray:
    """Return the robust weight of each observation, (M,), 1/px²."""
    square = (linear.residuals**2).sum(axis=1)
    return np.asarray(1 / (1 + square / scale**2) / linear.weighting_deviation**2)


def _inverse_point_blocks(
    bundle: TrackBundle, linear: BundleResiduals, weight: np.ndarray, damping: float
) -> csr_matrix:
    """Return the inverse of the points' part of normal equations, block diagonal."""
    jacobian, count = linear.by_points.data.reshape(-1, 2, 3), len(bundle.points)
    blocks = np.zeros((count, 3, 3))
    np.add.at(blocks, bundle.indices, np.einsum("n,nki,nkj->nij", weight, jacobian, jacobian))
    trace = np.trace(blocks, axis1=1, axis2=2)[:, None, None]
    # a little on the diagonal keeps points without parallax regular
    stiffness = CALIBRATION.min_point_stiffness * (trace + CALIBRATION.min_trace)
    inverse = np.linalg.inv(blocks + (damping * blocks + stiffness) * np.eye(3))
    indices = np.repeat(np.arange(3 * count).reshape(-1, 1, 3), 3, axis=1)
    return csr_matrix(
        (inverse.ravel(), indices.ravel(), np.arange(0, 9 * count + 1, 3)), shape=(3 * count,) * 2
    )


def _fix_scale(matrix: np.ndarray, poses: np.ndarray) -> None:
    """Add a term that keeps the scale: the distance of the farthest camera from the first one."""
    # positions of the first camera, in the coordinates of every frame
    first = poses[:, :, 3] - poses[:, :, :3] @ poses[0, :, :3].T @ poses[0, :, 3]
    lengths = np.linalg.norm(first, axis=1)
    far = int(np.argmax(lengths))
    along = np.zeros(len(matrix))
    along[6 * far : 6 * far + 3] = first[far] / max(lengths[far], CALIBRATION.min_bundle_length)
    matrix += np.outer(along, along) * matrix[6 * far, 6 * far]


def _add_zoom_prior(
    matrix: np.ndarray, gradient: np.ndarray, zoom: np.ndarray, frames: Sequence[int]
) -> None:
    """Add a prior to normal equations: the zoom per frame hardly changes; jumps weigh less."""
    count, change, deviation = len(frames), zoom_differences(frames), CALIBRATION.zoom_change
    weight = 1 / (1 + (change @ zoom / deviation) ** 2) / deviation**2
    weighted = change.T * weight
    part = slice(6 * count, 7 * count)
    matrix[part, part] += weighted @ change
    gradient[part] += weighted @ (change @ zoom)


def zoom_differences(frames: Sequence[int]) -> np.ndarray:
    """Return a matrix, (F − 2, F): the changes of the zoom per frame, by the zooms of frames."""
    count, steps = len(frames), np.diff(np.array(frames, np.float64))
    change = np.zeros((max(count - 2, 0), count))
    for k in range(count - 2):
        change[k, k : k + 3] = 1 / steps[k], -1 / steps[k] - 1 / steps[k + 1], 1 / steps[k + 1]
    return change
