"""Similarities in space, (4, 4) matrices (s R, t; 0, 1), and their fits to points."""

import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.reconstruction.geometry.settings import GEOMETRY
from tisfm.rigid import nearest_rotation


def sim3_scale(similarity: np.ndarray) -> float:
    """Return the scale s of a similarity."""
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))


def transform_points(similarity: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return transformed points, (N, 3)."""
    return np.asarray(points @ similarity[:3, :3].T + similarity[:3, 3])


def transform_pose(similarity: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return a transformed pose, (4, 4) camera to world."""
    transformed = similarity @ pose
    transformed[:3, :3] /= sim3_scale(similarity)
    return np.asarray(transformed)


def mean_pose(poses: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted mean of similar poses, (N, 4, 4), with weights, (N,)."""
    mean = np.asarray(np.average(poses, axis=0, weights=weights))
    mean[:3, :3] = nearest_rotation(mean[:3, :3])
    return mean


def mean_rotation(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the mean rotation, (3, 3), from `others`, (N, 4, 4), to `poses`."""
    rotations = np.tile(np.eye(4), (len(poses), 1, 1))
    rotations[:, :3, :3] = poses[:, :3, :3] @ others[:, :3, :3].mT
    return mean_pose(rotations, np.ones(len(rotations)))[:3, :3]


def sim3_from_vector(log_scale: float, rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return the similarity for the logarithm of a scale, a rotation vector and a translation."""
    similarity = np.eye(4)
    similarity[:3, :3] = np.exp(log_scale) * Rotation.from_rotvec(rotation).as_matrix()
    similarity[:3, 3] = shift
    return similarity


def fit_sim3(
    points: np.ndarray,  # (N, 3) float64
    others: np.ndarray,  # (N, 3) float64: the same points in the other system
    weights: np.ndarray,  # (N,) float64
    rotation: np.ndarray | None = None,  # (3, 3) float64; by default it is fitted too
) -> np.ndarray:
    """Return the similarity, (4, 4), that moves `others` nearest to `points`.

    Both sets are assumed to be equally exact: the scale is the ratio of their standard deviations,
    as in Horn's paper.

    References
    ----------
    Horn, "Closed-form solution of absolute orientation using unit quaternions", JOSA A 4 (1987),
    doi 10.1364/JOSAA.4.000629: sec. 2.D. The rotation is that of Umeyama, eq. 40–43,
    doi 10.1109/34.88573.
    """
    normalised_weights = (weights / weights.sum())[:, None]
    centre, other_centre = (
        (normalised_weights * points).sum(axis=0),
        (normalised_weights * others).sum(axis=0),
    )
    offsets, other_offsets = points - centre, others - other_centre
    variances = [
        (normalised_weights * differences**2).sum() for differences in (offsets, other_offsets)
    ]
    if rotation is None:
        rotation = nearest_rotation((normalised_weights * offsets).T @ other_offsets)
    similarity = np.eye(4)
    similarity[:3, :3] = np.sqrt(variances[0] / max(variances[1], 1e-300)) * rotation
    similarity[:3, 3] = centre - similarity[:3, :3] @ other_centre
    return similarity


def fit_sim3_ransac(
    # points, others: (N, 3) float64
    points: np.ndarray,
    others: np.ndarray,
    # (N,) float64: distances of the points from the camera; far points are less exact
    distances: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the similarity from `others` to `points` with most inliers, and the inliers.

    Returns the similarity, (4, 4) float64, and `is_inlier`, (N,) bool; or None if too few points
    are inliers.
    """
    min_count = max(GEOMETRY.min_inliers, GEOMETRY.min_inlier_share * len(points))
    if len(points) < max(3, min_count):
        return None
    generator, best, best_count = np.random.default_rng(0), np.eye(4), 0
    for _ in range(GEOMETRY.ransac_trials):
        sample = generator.choice(len(points), 3, replace=False)
        candidate = fit_sim3(points[sample], others[sample], np.ones(3))
        errors = relative_errors(candidate, points, others, distances)
        count = int((errors < GEOMETRY.max_inlier_error).sum())
        if count > best_count:
            best, best_count = candidate, count
    for _ in range(GEOMETRY.fit_rounds):
        errors = relative_errors(best, points, others, distances)
        is_inlier = errors < GEOMETRY.max_inlier_error
        if is_inlier.sum() < max(3, min_count):
            return None
        weights = _robust_weights(errors[is_inlier]) / distances[is_inlier] ** 2
        best = fit_sim3(points[is_inlier], others[is_inlier], weights)
    return best, relative_errors(best, points, others, distances) < GEOMETRY.max_inlier_error


def refine_sim3(
    similarity: np.ndarray,  # (4, 4) float64: start value
    # two (N, 3) float64: points in the target system, and the same points in the other system
    points: tuple[np.ndarray, np.ndarray],
    distances: np.ndarray,  # (N,) float64: distances of the points from the camera
    # two (M, 4, 4) float64: poses of the same views, camera to world, in the target system and in
    # the other system
    poses: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return a similarity that fits points and poses, with weights from their residuals.

    The rotation comes from the poses alone, whose rotations are exact.
    """
    rotation = mean_rotation(*poses)
    target, other = (
        np.vstack([system_points, system_poses[:, :3, 3]])
        for system_points, system_poses in zip(points, poses, strict=True)
    )
    depth = np.concatenate([distances, np.full(len(poses[0]), np.median(distances))])
    count = len(distances)
    for _ in range(GEOMETRY.fit_rounds):
        errors = relative_errors(similarity, target, other, depth)
        weights = [_robust_weights(errors[:count]), _robust_weights(errors[count:])]
        similarity = fit_sim3(target, other, np.concatenate(weights) / depth**2, rotation)
    return similarity


def _robust_weights(errors: np.ndarray) -> np.ndarray:
    """Return robust weights of residuals, (N,): outliers get small weights."""
    median = max(float(np.median(errors)), 1e-9)
    return np.asarray(1 / (median**2 + (errors / GEOMETRY.outlier_scale) ** 2))


def relative_errors(
    similarity: np.ndarray, points: np.ndarray, others: np.ndarray, distances: np.ndarray
) -> np.ndarray:
    """Return the errors of transformed `others`, (N,), divided by the distances of the points."""
    return np.asarray(
        np.linalg.norm(transform_points(similarity, others) - points, axis=1)
        / np.maximum(distances, 1e-300)
    )
