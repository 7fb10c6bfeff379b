"""Homographies of matched rays: their motions, and whether the rays show a single plane."""

import cv2
import numpy as np

from tisfm.motion.epipolar_fit import Pose, Rays, robust_deviation, usac_parameters
from tisfm.motion.settings import SPARSE
from tisfm.status import Status

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
    rays: Rays,
    *,
    min_share: float = 0.5,  # smallest share of the rays that meet the plane in front
) -> list[Pose]:
    """Return the motions of a homography whose plane lies in front of the camera."""
    _, rotations, translations, normals = cv2.decomposeHomographyMat(homography, np.eye(3))
    poses: list[Pose] = []
    for rotation, translation, normal in zip(rotations, translations, normals, strict=True):
        norm = float(np.linalg.norm(translation))
        if norm > 0 and np.quantile(normal[:, 0] @ rays.rays0, 1 - min_share) > 0:
            poses.append((np.asarray(rotation), np.asarray(translation[:, 0]) / norm))
    return poses


def plane_status(
    rays: Rays,  # rays of a flow field
    residual: float,  # robust deviation of the rays from the epipolar lines of the best motion, px
) -> Status | None:
    """Return a status if rays show one plane that allows two motions, else None.

    In general a homography has two decompositions. If the plane of one decomposition is behind the
    camera for some of the rays, this decomposition is wrong.

    References
    ----------
    Longuet-Higgins, "The reconstruction of a plane surface from two perspective projections",
    Proc. R. Soc. Lond. B 227 (1986), doi 10.1098/rspb.1986.0030; Malis and Vargas, "Deeper
    understanding of the homography decomposition for vision-based control", INRIA report 6303,
    2007.
    """
    sample = rays.subsample(max(1, rays.trust.size // SPARSE.plane_samples))
    homography, homography_error = _fit_homography(sample)
    if homography_error > SPARSE.max_plane_ratio * max(residual, SPARSE.min_plane_distance):
        return None
    poses: list[Pose] = []
    for pose in plane_poses(homography, sample, min_share=SPARSE.min_front_share):
        if all(angle_between(pose[1], other[1]) >= SPARSE.min_translation_angle for other in poses):
            poses.append(pose)
    return TWO_MOTIONS if len(poses) > 1 else None


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
        distance = rays.focal * np.hypot(*(homogeneous[:2] / homogeneous[2] - rays.rays1))
        scale = robust_deviation(distance, rays.trust)
        weight = rays.trust / (1 + (distance / max(scale, SPARSE.min_plane_distance)) ** 2)
    return homography, scale


def angle_between(direction0: np.ndarray, direction1: np.ndarray) -> float:
    """Return the angle between two vectors of length 1, rad."""
    return float(np.arccos(np.clip(direction0 @ direction1, -1, 1)))
