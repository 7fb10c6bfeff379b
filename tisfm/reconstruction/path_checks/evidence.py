"""Evidence of a pair of frames against the motion that a path states for it."""

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr

from tisfm.motion.camera_settings import INTRINSICS
from tisfm.motion.epipolar_fit import (
    EpipolarPoints,
    Pose,
    Rays,
    distance_jacobian,
    find_direction_covariance,
    length,
    nearest_points,
    robust_deviation,
    rotation_residual,
)
from tisfm.motion.focal_evidence import examine_focal
from tisfm.reconstruction.path_checks.dense_pairs import DensePair
from tisfm.reconstruction.path_checks.settings import PATH_CHECKS
from tisfm.reconstruction.result.path_check import LIMITS, PairEvidence


def weigh_pair(
    pair: DensePair,
    inverse_depth: np.ndarray | None,  # (h, w): of the shrunk first frame
) -> PairEvidence:
    """Return the evidence of a pair for and against the path."""
    path_points, free_points = (nearest_points(pair.rays, *pose) for pose in (pair.path, pair.free))
    path_residual, free_residual = (
        robust_deviation(np.abs(points.distance), pair.rays.trust)
        for points in (path_points, free_points)
    )
    limit = max(PATH_CHECKS.off_line_distance, PATH_CHECKS.off_line_deviations * free_residual)
    off_path, off_free = (
        float((np.abs(points.distance) > limit).mean()) for points in (path_points, free_points)
    )
    path_parallax, free_parallax = (
        pair.rays.focal * length(rotation_residual(pair.rays, pose[0]))
        for pose in (pair.path, pair.free)
    )
    behind = (path_points.inverse_depth < 0) & (path_parallax > limit)
    zoom, zoom_deviation, zoom_residual = fit_zoom(pair.rays, pair.free)
    focal = examine_focal(pair.rays, pair.free)
    focal_changes = focal.largest_changes(INTRINSICS.max_wrong_focal)
    return PairEvidence(
        first=pair.first,
        second=pair.second,
        excess=off_path - off_free,
        residual_ratio=max(path_residual, PATH_CHECKS.min_residual)
        / max(free_residual, PATH_CHECKS.min_residual),
        direction=measure_angle(pair.path[1], pair.free[1]),
        direction_deviation=find_direction_deviation(pair.rays, pair.free),
        rotation=measure_turn(pair.path[0] @ pair.free[0].T),
        behind=float(behind.mean()),
        rank=correlate_depth(pair, free_points, inverse_depth),
        zoom=zoom,
        zoom_deviation=zoom_deviation,
        zoom_gain=max(free_residual, PATH_CHECKS.min_zoom_residual)
        / max(zoom_residual, PATH_CHECKS.min_zoom_residual),
        parallax=float(np.median(free_parallax)) / max(pair.shape),
        focal_value=focal.value,
        focal_deviation=focal.value_deviation,
        focal_depth=focal_changes[0],
        focal_direction=float(np.degrees(focal_changes[1])),
        focal_rotation=float(np.degrees(focal_changes[2])),
    )


def measure_angle(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle between two vectors, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))


def measure_turn(rotation: np.ndarray) -> float:
    """Return the angle of a rotation, (3, 3), degrees."""
    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))


def find_direction_deviation(rays: Rays, pose: Pose) -> float:
    """Return the standard deviation of the direction of translation of a fitted motion, degrees."""
    covariance = find_direction_covariance(
        rays,
        pose,
        independent_rays=rays.trust.size / PATH_CHECKS.correlated_pixels,
        min_scale=PATH_CHECKS.min_scale,
    )
    return float(np.degrees(np.sqrt(max(float(np.trace(covariance)), 0.0))))


def correlate_depth(
    pair: DensePair, points: EpipolarPoints, inverse_depth: np.ndarray | None
) -> float | None:
    """Return the rank correlation of depth with that of a motion; None for too few pixels."""
    if inverse_depth is None:
        return None
    depth = inverse_depth[pair.rows, pair.columns]
    valid = np.isfinite(depth) & (depth > 0)
    if valid.sum() < PATH_CHECKS.min_pixels:
        return None
    rank = float(spearmanr(depth[valid], points.inverse_depth[valid]).statistic)
    return rank if np.isfinite(rank) else None  # it is NaN if one of the depths is constant


def fit_zoom(rays: Rays, pose: Pose) -> tuple[float, float, float]:
    """Fit a motion with a zoom about the centre of the frame.

    Returns the logarithm of the zoom, its standard deviation, and the residual, px.
    """
    rotation, translation = pose
    zoom, scale, matrix = 0.0, 0.0, np.eye(7)
    for _ in range(PATH_CHECKS.zoom_iterations):
        unzoomed = Rays(
            rays0=rays.rays0,
            rays1=rays.rays1 * np.exp(-zoom),
            trust=rays.trust,
            focal=rays.focal,
        )
        points = nearest_points(unzoomed, rotation, translation)
        by_zoom = rays.focal * (
            points.normal_x * unzoomed.rays1[0] + points.normal_y * unzoomed.rays1[1]
        )
        jacobian = np.vstack([distance_jacobian(points, rays.focal), by_zoom])
        matrix, scale = _make_normal_equations(points, unzoomed, jacobian)
        weight = _weigh_distances(points.distance, scale, rays.trust)
        gradient = jacobian @ (weight * points.distance) / scale**2 / PATH_CHECKS.correlated_pixels
        along = np.concatenate([translation, np.zeros(4)])
        # The length of the translation is not determined; a little on the diagonal avoids 0 / 0.
        matrix += (np.trace(matrix) + 1e-30) * (np.outer(along, along) + 1e-9 * np.eye(7))
        matrix[6, 6] += 1 / LIMITS.zoom_prior**2
        gradient[6] -= zoom / LIMITS.zoom_prior**2
        step = np.linalg.solve(matrix, gradient)
        turn = Rotation.from_rotvec(step[3:6]).as_matrix()
        rotation, translation = turn @ rotation, turn @ translation + step[:3]
        translation = translation / np.linalg.norm(translation)
        zoom = float(np.clip(zoom + step[6], -PATH_CHECKS.max_zoom, PATH_CHECKS.max_zoom))
        if np.linalg.norm(step) < PATH_CHECKS.min_zoom_step:
            break
    return zoom, float(np.sqrt(np.linalg.inv(matrix)[6, 6])), scale


def _make_normal_equations(
    points: EpipolarPoints, rays: Rays, jacobian: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the information matrix of a robust fit, and the deviation of distances, px."""
    scale = max(robust_deviation(np.abs(points.distance), rays.trust), PATH_CHECKS.min_scale)
    weight = _weigh_distances(points.distance, scale, rays.trust)
    return (jacobian * weight) @ jacobian.T / scale**2 / PATH_CHECKS.correlated_pixels, scale


def _weigh_distances(distance: np.ndarray, scale: float, trust: np.ndarray) -> np.ndarray:
    return np.asarray(trust / (1 + (distance / (2 * scale)) ** 2) ** 2)
