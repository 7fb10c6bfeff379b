"""Homographies of matched rays: their motions, and whether the rays show a single plane."""

import cv2
import numpy as np

from tisfm.motion.epipolar_fit import (
    MIN_LENGTH,
    FreeUnknowns,
    Pose,
    Rays,
    nearest_points,
    refine_pose,
    robust_deviation,
    usac_parameters,
)
from tisfm.motion.settings import SPARSE
from tisfm.status import Status

ALL_FREE = FreeUnknowns(count=6, likely_rotation=None)
TWO_MOTIONS = Status(
    "two_motions",
    "two camera motions explain the frames equally well, as if the frames show a single plane, so "
    "depth may belong to the wrong motion: take frames that show more than a plane, or give the "
    "pose",
)


def sample_homographies(rays: Rays) -> list[np.ndarray]:
    """Return homographies of normalised coordinates by random sampling, (3, 3) each."""
    # OpenCV finds no homography of small coordinates, so coordinates are in px.
    points0, points1 = (rays.focal * points[:2].T for points in (rays.rays0, rays.rays1))
    to_px = np.diag([rays.focal, rays.focal, 1.0])
    homographies = []
    for threshold in SPARSE.inlier_distances:
        try:
            matrix, _ = cv2.findHomography(
                points0, points1, usac_parameters(threshold, SPARSE.max_draws)
            )
        except cv2.error:  # the samples determine no homography
            continue
        if matrix is not None and matrix.shape == (3, 3) and np.isfinite(matrix).all():
            homographies.append(np.linalg.solve(to_px, matrix @ to_px))
    return homographies


def plane_poses(
    homography: np.ndarray,  # (3, 3): for normalised coordinates
    rays0: np.ndarray,  # (3, N)
    *,
    min_share: float = 0.5,  # smallest share of the rays that meet the plane in front
) -> list[Pose]:
    """Return the motions of a homography whose plane lies in front of the camera."""
    _, rotations, translations, normals = cv2.decomposeHomographyMat(homography, np.eye(3))
    in_front = np.count_nonzero(np.hstack(normals).T @ rays0 > 0, axis=1)
    poses: list[Pose] = []
    for rotation, translation, count in zip(rotations, translations, in_front, strict=True):
        norm = float(np.linalg.norm(translation))
        if norm > 0 and count > min_share * rays0.shape[1]:
            poses.append((np.asarray(rotation), np.asarray(translation[:, 0]) / norm))
    return poses


def resolve_plane(
    rays: Rays,  # of a flow field
    pose: Pose,  # the motion that fits the rays best, ‖t‖ = 1
    residual: float,  # robust deviation of the rays from the epipolar lines of this motion, px
) -> tuple[Pose, Status | None]:
    """Return the motion of rays that may show one plane, and a status if a second one is as likely.

    In general a homography has two decompositions. If the plane of one decomposition is behind the
    camera for some of the rays, this decomposition is wrong. The motion of the other one is then
    returned, even if the wrong motion fits the rays a little better. A second motion is as likely
    only if it explains all rays as well, and not only those near the plane.

    References
    ----------
    Longuet-Higgins, "The reconstruction of a plane surface from two perspective projections",
    Proc. R. Soc. Lond. B 227 (1986), doi 10.1098/rspb.1986.0030; Malis and Vargas, "Deeper
    understanding of the homography decomposition for vision-based control", INRIA report 6303,
    2007.
    """
    sample = rays.subsample(max(1, rays.trust.size // SPARSE.plane_samples))
    homography, homography_error = _fit_homography(sample)
    smallest = max(residual, SPARSE.min_plane_distance)
    if homography_error > SPARSE.max_plane_ratio * smallest:
        return pose, None
    in_front = plane_poses(homography, sample.rays0, min_share=SPARSE.min_front_share)
    others = [
        (rotation, translation)
        for start in in_front
        if _is_other(start, pose)
        for rotation, translation, _ in [
            refine_pose(sample, start, ALL_FREE, iterations=SPARSE.plane_iterations)
        ]
        if _is_other((rotation, translation), pose)
        and _residual(sample, (rotation, translation)) < SPARSE.max_second_residual * smallest
    ]
    if not others:
        return pose, None
    if all(_is_other(start, pose) for start in in_front):  # its own plane is partly behind
        return others[0], None
    return pose, TWO_MOTIONS


def _is_other(pose: Pose, reference: Pose) -> bool:
    """Return whether the translations of two motions differ clearly."""
    return angle_between(pose[1], reference[1]) >= SPARSE.min_translation_angle


def _residual(rays: Rays, pose: Pose) -> float:
    """Return the robust deviation of rays from the epipolar lines of a motion, px."""
    return robust_deviation(np.abs(nearest_points(rays, *pose).distance), rays.trust)


def find_near_plane(
    rays: Rays,  # of a flow field
    pose: Pose,  # the motion that fits the rays best, ‖t‖ = 1
) -> np.ndarray | None:
    """Return the homography of rays that show nearly one plane, (3, 3), else None."""
    homography, error = _fit_homography(rays)
    smallest = max(_residual(rays, pose), SPARSE.min_plane_distance)
    return homography if error < SPARSE.max_near_plane_ratio * smallest else None


def _fit_homography(rays: Rays) -> tuple[np.ndarray, float]:
    """Return the homography that fits rays best, (3, 3), and the deviation of the fit, px."""
    rays0 = rays.rays0
    x, y = rays.rays1
    zeros = np.zeros_like(rays0)
    # two equations for each ray, (9, 2N)
    system = np.hstack(
        [np.vstack([rays0, zeros, -x * rays0]), np.vstack([zeros, rays0, -y * rays0])]
    )
    weight = rays.trust
    for _ in range(SPARSE.plane_rounds):
        normal = (system * np.tile(weight, 2)) @ system.T
        homography = np.linalg.eigh(normal)[1][:, 0].reshape(3, 3)
        homogeneous = homography @ rays0
        nearness = 1 / np.where(homogeneous[2] == 0, MIN_LENGTH, homogeneous[2])
        distance = rays.focal * np.hypot(*(homogeneous[:2] * nearness - rays.rays1))
        scale = robust_deviation(distance, rays.trust)
        weight = rays.trust / (1 + (distance / max(scale, SPARSE.min_plane_distance)) ** 2)
    return homography, scale


def angle_between(direction0: np.ndarray, direction1: np.ndarray) -> float:
    """Return the angle between two vectors of length 1, rad."""
    return float(np.arccos(np.clip(direction0 @ direction1, -1, 1)))
