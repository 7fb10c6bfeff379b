"""Standard deviations of the poses of a piece of a path.

The normal equations of poses and points are set up once more at the end of the path, and the points
are eliminated (Schur complement). The errors of a track in its frames are correlated, since the
track drifts. So the covariance comes from the gradients of whole tracks (a cluster-robust, or
sandwich, covariance), not from the residuals of single observations.

A covariance depends on the choice of the coordinate system. Here each pose counts after the best
alignment of the path: positions after the best similarity, orientations after the best rotation.
"""

from dataclasses import dataclass

import numpy as np

from tisfm.reconstruction.calibration.bundle_residuals import COMMON, BundleState, linearise
from tisfm.reconstruction.calibration.normal_equations import (
    multiply_by_columns,
    reduce_equations,
    track_gradients,
)
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.calibration.track_bundle import TrackBundle
from tisfm.reconstruction.geometry.rays import cross_matrices
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.settings import POSE_DEVIATION


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseDeviations:
    """Standard deviations of poses, in the axes of the cameras."""

    frames: tuple[int, ...]  # numbers of the F frames, in order
    position: np.ndarray  # (F, 3) float64: along X, Y and Z, unit of the poses
    rotation: np.ndarray  # (F, 3) float64: about X, Y and Z, degrees


def find_pose_deviations(
    path: CameraPath,
    piece: Piece,  # a piece of the path, with positions
    shape: tuple[int, int],  # height and width of the frames, px
    focal_deviation: float,  # relative standard deviation of the focal length
) -> PoseDeviations | None:
    """Return the deviations of the poses of a piece; None if its tracks do not determine them.

    The frames of a long piece are divided into windows, each with an alignment of its own. Frames
    with few tracks are left out.

    References
    ----------
    Triggs et al., "Bundle adjustment – a modern synthesis", 2000, doi 10.1007/3-540-44480-7_21,
    section 9. Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986,
    doi 10.1093/biomet/73.1.13: covariance from clusters of observations.
    """
    camera = path.camera.pinhole()
    window_count = -(-len(piece.poses) // POSE_DEVIATION.max_frames)
    frames: list[int] = []
    variances: list[np.ndarray] = []
    for window in np.array_split(np.array(list(piece.poses)), window_count):
        bundle = TrackBundle.from_piece(piece, path.observations, window.tolist(), camera, shape)
        counts = np.bincount(bundle.views, minlength=len(window))
        if (counts < POSE_DEVIATION.min_tracks).any():
            window = window[counts >= POSE_DEVIATION.min_tracks]
            if len(window) < CALIBRATION.min_bundle_frames:
                continue
            bundle = TrackBundle.from_piece(
                piece, path.observations, window.tolist(), camera, shape
            )
        found = _find_variances(bundle, camera.focal, path.zoom, focal_deviation)
        if found is not None:
            frames += bundle.frames
            variances.append(found)
    if not variances:
        return None
    deviations = np.sqrt(np.concatenate(variances))
    return PoseDeviations(
        frames=tuple(frames),
        position=POSE_DEVIATION.position_factor * deviations[:, :3],
        rotation=POSE_DEVIATION.rotation_factor * np.degrees(deviations[:, 3:]),
    )


def _find_variances(
    bundle: TrackBundle,
    focal: float,  # px
    zoom: np.ndarray | None,  # as `CameraPath.zoom`
    focal_deviation: float,  # relative
) -> np.ndarray | None:
    """Return the variances of the positions and orientations of frames, (F, 6); None if unknown."""
    covariance = _find_covariance(bundle, focal, zoom, focal_deviation)
    if covariance is None or not np.isfinite(covariance).all():
        return None
    count = len(bundle.frames)
    rotation = bundle.poses[:, :, :3]
    to_world = np.swapaxes(rotation, 1, 2)
    # A step (t, ω) of a pose moves the camera by −Rᵀt, and turns it by −Rᵀω, in the world.
    blocks = covariance.reshape(count, 6, count, 6)
    centers = -np.einsum("nji,nj->ni", rotation, bundle.poses[:, :, 3])
    variances = []
    for part, motions in (
        (slice(0, 3), _similarity_motions(centers)),
        (slice(3, 6), np.tile(np.eye(3), (count, 1))),
    ):
        in_world = np.einsum(
            "nij,njmk,mlk->niml", to_world, blocks[:, part, :, part], to_world, optimize=True
        )
        aligned = _remove_motions(in_world.reshape(3 * count, 3 * count), motions)
        of_frames = np.einsum("nink->nik", aligned.reshape(count, 3, count, 3))
        in_camera = np.einsum("nij,njk,nik->ni", rotation, of_frames, rotation)
        variances.append(np.maximum(in_camera, 0))
    return np.concatenate(variances, axis=1)


def _find_covariance(
    bundle: TrackBundle,
    focal: float,
    zoom: np.ndarray | None,
    focal_deviation: float,
) -> np.ndarray | None:
    """Return the covariance of the steps of the poses, (6 F, 6 F); None if tracks are too few.

    The pose of the first frame is fixed. The zoom of frames is free if the path has a zoom.
    """
    count = len(bundle.frames)
    # The residuals are smaller than the errors of the tracks, since the unknowns fit them.
    number_count = 2 * len(bundle.positions)
    freedom = number_count - 3 * len(bundle.points) - 6 * count
    if freedom <= 0:
        return None
    is_free = np.zeros(7 * count + len(COMMON), bool)
    is_free[6 : 6 * count] = True
    is_free[6 * count + 1 : 7 * count] = zoom is not None
    is_free[7 * count] = True  # the focal length
    state = BundleState(
        poses=bundle.poses,
        points=bundle.points,
        common=np.array([np.log(focal), *np.zeros(len(COMMON) - 1)]),
        zoom=np.zeros(count),
        removed_zoom=np.zeros(count) if zoom is None else np.log(zoom[list(bundle.frames)]),
    )
    linear, scale = linearise(bundle, state), CALIBRATION.bundle_scales[-1]
    reduced = reduce_equations(bundle, state, linear, is_free, scale)
    matrix = reduced.matrix[:-1, :-1]  # without the focal length
    if not np.isfinite(matrix).all():
        return None
    gradients = track_gradients(bundle, linear, reduced, is_free, scale)[:-1]
    diagonal = np.diag(matrix)
    stiffness = np.where(diagonal > 0, POSE_DEVIATION.min_stiffness * diagonal, 1.0)
    inverse = np.linalg.inv(matrix + np.diag(stiffness))[: 6 * count - 6]
    by_focal = inverse @ reduced.matrix[:-1, -1]
    covariance = np.zeros((6 * count, 6 * count))
    spread = multiply_by_columns(gradients, gradients) * number_count / freedom
    covariance[6:, 6:] = inverse @ spread @ inverse.T
    covariance[6:, 6:] += np.outer(by_focal, by_focal) * focal_deviation**2
    return covariance


def _similarity_motions(centers: np.ndarray) -> np.ndarray:
    """Return the motions of positions, (F, 3), under small similarities, (3 F, 7)."""
    count = len(centers)
    shifted = centers - centers.mean(axis=0)
    shifted /= max(float(np.sqrt((shifted**2).mean())), CALIBRATION.min_bundle_length)
    shifts = np.tile(np.eye(3), (count, 1))
    turns = -cross_matrices(shifted).reshape(3 * count, 3)
    return np.concatenate([shifts, turns, shifted.reshape(3 * count, 1)], axis=1)


def _remove_motions(covariance: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """Return the covariance, (K, K), of what remains after a fit of motions, (K, M)."""
    basis, sizes, _ = np.linalg.svd(motions, full_matrices=False)
    basis = basis[:, sizes > POSE_DEVIATION.min_motion * sizes[0]]
    product = covariance @ basis
    return np.asarray(
        covariance - basis @ product.T - product @ basis.T + basis @ (basis.T @ product) @ basis.T
    )
