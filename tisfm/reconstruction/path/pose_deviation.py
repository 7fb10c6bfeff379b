"""Standard deviations of the poses of a piece of a path.

The normal equations of poses and points are set up once more at the end of the path, and the points
are eliminated (Schur complement). The errors of a track in its frames are correlated, since the
track drifts. So the covariance comes from the gradients of whole tracks (a cluster-robust, or
sandwich, covariance), not from the residuals of single observations.

A covariance depends on the choice of the coordinate system. Here each pose counts after the best
alignment of the path: positions after the best similarity, orientations after the best rotation.

Depth follows from the poses, so the points that move with the poses show how far depth is off
because of them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, hstack

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
    """Standard deviations of poses, in the axes of the cameras; NaN where unknown."""

    frames: tuple[int, ...]  # numbers of the F frames, in order
    position: np.ndarray  # (F, 3) float64: along X, Y and Z, unit of the poses
    rotation: np.ndarray  # (F, 3) float64: about X, Y and Z, degrees
    # (F,) float64: relative standard deviation of depth because of the poses, median over the
    # points of a frame, apart from a factor that all of them share
    relative_depth: np.ndarray


def find_pose_deviations(
    path: CameraPath,
    piece: Piece,  # a piece of the path, with positions
    shape: tuple[int, int],  # height and width of the frames, px
    focal_deviation: float,  # relative standard deviation of the focal length
) -> PoseDeviations | None:
    """Return the deviations of the poses of a piece; None if its tracks do not determine them.

    The frames are divided into windows, each with an alignment of its own: at the joints of the
    piece, whose parts share no tracks, and where a part is long. Frames with few tracks are left
    out.

    References
    ----------
    Triggs et al., "Bundle adjustment – a modern synthesis", 2000, doi 10.1007/3-540-44480-7_21,
    section 9. Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986,
    doi 10.1093/biomet/73.1.13: covariance from clusters of observations.
    """
    camera = path.camera.pinhole()
    frames: list[int] = []
    variances: list[np.ndarray] = []
    for window in _split_windows(piece):
        bundle = _make_bundle(path, piece, window, shape)
        if bundle is None:
            continue
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
        rotation=POSE_DEVIATION.rotation_factor * np.degrees(deviations[:, 3:6]),
        relative_depth=POSE_DEVIATION.position_factor * deviations[:, 6],
    )


def _split_windows(piece: Piece) -> list[np.ndarray]:
    """Return the frames of the windows of a piece, in order."""
    frames = np.array(list(piece.poses))
    windows = []
    for part in np.split(frames, np.searchsorted(frames, piece.joints)):
        windows += np.array_split(part, -(-len(part) // POSE_DEVIATION.max_frames))
    return windows


def _make_bundle(
    path: CameraPath, piece: Piece, window: np.ndarray, shape: tuple[int, int]
) -> TrackBundle | None:
    """Return the tracks of a window, without frames with few tracks; None if too few remain.

    A track is lost if too few of the remaining frames show it, so other frames may then have few.
    """
    camera = path.camera.pinhole()
    while len(window) >= CALIBRATION.min_bundle_frames:
        bundle = TrackBundle.from_piece(piece, path.observations, window.tolist(), camera, shape)
        counts = np.bincount(bundle.views, minlength=len(window))
        has_tracks = counts >= POSE_DEVIATION.min_tracks
        if has_tracks.all():
            return bundle
        window = window[has_tracks]
    return None


def _find_variances(
    bundle: TrackBundle,
    focal: float,  # px
    zoom: np.ndarray | None,  # as `CameraPath.zoom`
    focal_deviation: float,  # relative
) -> np.ndarray | None:
    """Return the variances of frames, (F, 7); None if unknown.

    They are those of the position, of the orientation, and of the relative depth. A variance that
    is not above 0, from rounding, is NaN: unknown.
    """
    found = _find_covariance(bundle, focal, zoom)
    if found is None or not np.isfinite(found.matrix).all():
        return None
    of_depth = _find_depth_variances(bundle, found)
    covariance = found.matrix + np.outer(found.by_focal, found.by_focal) * focal_deviation**2
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
        variances.append(in_camera)
    found_variances = np.concatenate([*variances, of_depth[:, None]], axis=1)
    return np.where(found_variances > 0, found_variances, np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class _PoseCovariance:
    """The covariance of the steps (t, ω) of poses, and what follows from a step."""

    matrix: np.ndarray  # (6 F, 6 F): for an exact focal length
    by_focal: np.ndarray  # (6 F,): derivative by the logarithm of the focal length
    point_moves: csr_matrix  # (3 P, 6 F): motion of the points by the steps of the poses


def _find_covariance(
    bundle: TrackBundle, focal: float, zoom: np.ndarray | None
) -> _PoseCovariance | None:
    """Return the covariance of the steps of the poses; None if tracks are too few.

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
    free_count = 6 * count - 6
    inverse = np.linalg.inv(matrix + np.diag(stiffness))[:free_count]
    covariance, by_focal = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
    spread = multiply_by_columns(gradients, gradients) * number_count / freedom
    covariance[6:, 6:] = inverse @ spread @ inverse.T
    by_focal[6:] = -inverse @ reduced.matrix[:-1, -1]
    moves = -reduced.inverse_points @ reduced.coupling[:free_count].T
    fixed = csr_matrix((moves.shape[0], 6))
    return _PoseCovariance(
        matrix=covariance, by_focal=by_focal, point_moves=hstack([fixed, moves]).tocsr()
    )


def _find_depth_variances(bundle: TrackBundle, covariance: _PoseCovariance) -> np.ndarray:
    """Return the variance of the relative depth of each frame because of the poses, (F,).

    It is NaN if the points of no frame show it.
    """
    count = len(bundle.frames)
    known, variances = [], []
    for k in range(0, count, -(-count // POSE_DEVIATION.depth_frames)):
        relative = _find_depth_changes(bundle, covariance, k)
        variance = _find_own_variance(relative, covariance.matrix) if len(relative) else 0.0
        if variance > 0:
            known.append(k)
            variances.append(variance)
    return np.interp(np.arange(count), known, variances) if known else np.full(count, np.nan)


def _find_depth_changes(bundle: TrackBundle, covariance: _PoseCovariance, k: int) -> np.ndarray:
    """Return the relative change of the depth of J points of frame k by the poses, (J, 6 F).

    Points behind the camera, or much nearer than most, are left out.
    """
    indices = bundle.indices[bundle.views == k]
    rotation, shift = bundle.poses[k, :, :3], bundle.poses[k, :, 3]
    local = bundle.points[indices] @ rotation.T + shift
    depth = local[:, 2]
    rows = np.flatnonzero(depth > max(POSE_DEVIATION.min_depth * np.median(depth), 0))
    rows = rows[:: max(1, -(-len(rows) // POSE_DEVIATION.depth_tracks))]
    coordinates = 3 * indices[rows, None] + np.arange(3)
    moves = covariance.point_moves[coordinates.ravel()].toarray()
    by_step = np.einsum("c,jck->jk", rotation[2], moves.reshape(len(rows), 3, -1))
    by_step[:, 6 * k + 2] += 1  # of Z by t, and by ω × X
    by_step[:, 6 * k + 3] += local[rows, 1]
    by_step[:, 6 * k + 4] -= local[rows, 0]
    return np.asarray(by_step / depth[rows, None])


def _find_own_variance(relative: np.ndarray, matrix: np.ndarray) -> float:
    """Return the median variance of relative depths, (J, 6 F), apart from their shared factor.

    The factor is their mean, and then the mean of those that are not far off the first one.
    """
    relative = relative - relative.mean(axis=0)
    products = relative @ matrix @ relative.T
    own = np.diag(products)
    weights = own <= POSE_DEVIATION.max_depth_change**2 * max(float(np.median(own)), 0)
    weights = weights / weights.sum()
    by_factor = products @ weights
    return float(np.median(own - 2 * by_factor + weights @ by_factor))


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
