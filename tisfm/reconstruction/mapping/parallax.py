"""Parallax of views: residual angles after simple motions, and removal of points without parallax.

A first pair of a path needs parallax that neither a homography nor a rotation explains. Without
such parallax the translation is unknown, and any reconstruction from the pair is arbitrary.
"""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

# Values without a stated source were set by hand.

# rad: matching noise; it bounds the weight of small angles in the robust fits.
MATCH_NOISE = 5e-4
# Reweighted rounds of the linear fit of a homography.
HOMOGRAPHY_ROUNDS = 5
# Gauss–Newton steps of the fit of a rotation and a focal length.
ROTATION_STEPS = 12
# A smaller step, in rad and in the logarithm of the focal length, ends this fit.
MIN_ROTATION_STEP = 1e-5
# Bounds of the focal length in the fit of a rotation, as multiples of the stated focal length. When
# only the stated one was allowed, 20 % off, 7 of 8 rendered pure rotations passed for parallax.
MIN_FOCAL_RATIO = 0.5
MAX_FOCAL_RATIO = 2.0
# Smallest z of a unit direction that is projected.
MIN_Z = 1e-3
# Smallest distance to another view that sees a point, as a share of a view's median depth.
MIN_BASELINE = 0.02


def beyond_homography(
    # before, after: (N, 3) float64, unit directions to matching points in two views
    before: np.ndarray,
    after: np.ndarray,
) -> np.ndarray:  # (N,) float64: angles, rad
    """Return the residual angles after the best homography."""
    x, y, z = after.T[:, :, None]
    zero = np.zeros_like(before)
    equations = np.stack(  # of the nine entries of H, row by row: after × (H before) = 0
        [
            np.hstack([zero, -z * before, y * before]),
            np.hstack([z * before, zero, -x * before]),
            np.hstack([-y * before, x * before, zero]),
        ]
    )
    weights = np.ones(len(before))
    for _ in range(HOMOGRAPHY_ROUNDS):
        weighted = (equations * weights[:, None]).reshape(-1, 9)
        moved = before @ np.linalg.eigh(weighted.T @ weighted)[1][:, 0].reshape(3, 3).T
        moved /= np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-12)
        angles = np.linalg.norm(np.cross(after, moved), axis=1)
        weights = 1 / np.sqrt(angles + MATCH_NOISE)
    return np.asarray(angles)


def beyond_rotation(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the residual angles after the best rotation, fitted together with a focal length.

    The focal length is the same in both views, and 0.5 to 2 times the stated focal length, with
    which the directions were computed. So a rotation seen with a wrong focal length shows no
    parallax.

    Parameters and result are those of `beyond_homography`. The angles are computed with the stated
    focal length.
    """
    seen = (before[:, 2] > MIN_Z) & (after[:, 2] > MIN_Z)
    start, end = (rays[seen, :2] / rays[seen, 2:] for rays in (before, after))
    angles = np.full(len(before), np.pi)
    if len(start):
        moved = np.column_stack([_moved_by_rotation(start, end), np.ones(len(start))])
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        angles[seen] = np.linalg.norm(np.cross(after[seen], moved), axis=1)
    return angles


def _moved_by_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return points moved by the best rotation and focal length; all (N, 2), in focal lengths."""
    rotation, log_focal, weights = np.eye(3), 0.0, np.ones(len(start))
    for number in range(ROTATION_STEPS):
        focal = np.exp(log_focal)
        x, y, z = (np.column_stack([start / focal, np.ones(len(start))]) @ rotation.T).T
        z = np.maximum(z, MIN_Z)
        u, v = x / z, y / z
        moved = focal * np.column_stack([u, v])
        left = end - moved
        distance = np.hypot(*left.T)
        if number:
            weights = 1 / (distance + MATCH_NOISE)
        # Derivatives of the projection by a rotation (ω × ray) from the left, and by log f.
        by_rotation = focal * np.stack(
            [np.column_stack([-u * v, -1 - v * v]), np.column_stack([1 + u * u, u * v]),
             np.column_stack([-v, u])], axis=2,
        )  # fmt: skip
        back = -start / focal @ rotation[:, :2].T  # d(ray)/d(log f)
        by_focal = focal * np.column_stack(
            [u + (back[:, 0] - u * back[:, 2]) / z, v + (back[:, 1] - v * back[:, 2]) / z]
        )
        slope = np.concatenate([by_rotation, by_focal[:, :, None]], axis=2)
        weighted = slope * weights[:, None, None]
        matrix = np.einsum("nik,nil->kl", weighted, slope)
        vector = np.einsum("nik,ni->k", weighted, left)
        matrix += 1e-9 * np.trace(matrix) * np.eye(4) + 1e-30 * np.eye(4)
        step = np.linalg.solve(matrix, vector)
        wanted = log_focal + step[3]
        limited = float(np.clip(wanted, np.log(MIN_FOCAL_RATIO), np.log(MAX_FOCAL_RATIO)))
        if limited != wanted:  # the best rotation at the limit
            vector = vector - matrix[:, 3] * (limited - log_focal)
            step = np.r_[np.linalg.solve(matrix[:3, :3], vector[:3]), limited - log_focal]
        rotation = _rotation(step[:3]) @ rotation
        log_focal = limited
        if number and np.abs(step).max() < MIN_ROTATION_STEP:
            break
    return moved


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a rotation vector, rad."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


class LowParallaxFilter:
    """Deletes the points of a model that are seen from one camera position only.

    Where the camera only rotates, the translation between views is noise, and so is the depth of
    points that only these views see. Such points seem very near, and views added from them get a
    wrong scale.
    """

    def __init__(
        self,
        mapper: Any,
        reconstruction: Any,  # the reconstruction that the mapper works on
    ) -> None:
        self._mapper, self._reconstruction = mapper, reconstruction
        self._known: set[int] = set()  # points that are seen from several positions

    def delete(self, number: int) -> None:
        """Delete such points of the view with this number.

        A deleted point may be triangulated again with a view from another position.
        """
        images, points = self._reconstruction.images, self._reconstruction.points3D
        image = images[number]
        # Without repetition: the track of a point may contain two observations of one view.
        seen = list(dict.fromkeys(one.point3D_id for one in image.points2D if one.has_point3D()))
        if not seen:
            return
        pose = image.cam_from_world().matrix()
        depth = np.array([points[one].xyz for one in seen]) @ pose[2, :3] + pose[2, 3]
        least = MIN_BASELINE * float(np.median(depth))
        here = image.projection_center()
        away: dict[int, float] = {}
        for one in seen:
            if one in self._known:
                continue
            numbers = [element.image_id for element in points[one].track.elements]
            for other in numbers:
                if other not in away:
                    away[other] = float(np.linalg.norm(images[other].projection_center() - here))
            if max(away[other] for other in numbers) >= least:
                self._known.add(one)
            else:
                self._mapper.observation_manager.delete_point3D(one)
