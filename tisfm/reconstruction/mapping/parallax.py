"""Parallax of views: residual angles after simple motions, and removal of points without parallax.

A first pair of a path needs parallax that neither a homography nor a rotation explains. Without
such parallax the translation is unknown, and any reconstruction from the pair is arbitrary.
"""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.reconstruction.mapping.settings import MAPPING

# Smallest z of a unit direction that is projected to an image. Set by hand.
MIN_Z = 1e-3


def epipolar_angles(
    # pose0, pose1: (3, 4) array, world to camera, of two views
    pose0: np.ndarray,
    pose1: np.ndarray,
    # before, after: (N, 3) array, unit directions to matching points in these views
    before: np.ndarray,
    after: np.ndarray,
) -> np.ndarray:
    """Return the angles of directions in the second view to their epipolar planes, (N,), rad."""
    rotation = pose1[:, :3] @ pose0[:, :3].T
    normal = np.cross(pose1[:, 3] - rotation @ pose0[:, 3], before @ rotation.T)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.abs((after * normal).sum(axis=1))


def homography_residuals(
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
    for _ in range(MAPPING.homography_rounds):
        weighted = (equations * weights[:, None]).reshape(-1, 9)
        mapped = before @ np.linalg.eigh(weighted.T @ weighted)[1][:, 0].reshape(3, 3).T
        mapped /= np.maximum(np.linalg.norm(mapped, axis=1, keepdims=True), 1e-12)
        angles = np.linalg.norm(np.cross(after, mapped), axis=1)
        weights = 1 / np.sqrt(angles + MAPPING.match_noise)
    return np.asarray(angles)


def rotation_residuals(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the residual angles after the best rotation, fitted together with a focal length.

    The focal length is the same in both views, and 0.5 to 2 times the stated focal length, with
    which the directions were computed. So a rotation seen with a wrong focal length shows no
    parallax.

    Parameters and result are as for `homography_residuals`. The angles are computed with the
    stated focal length.
    """
    is_visible = (before[:, 2] > MIN_Z) & (after[:, 2] > MIN_Z)
    start, end = (rays[is_visible, :2] / rays[is_visible, 2:] for rays in (before, after))
    angles = np.full(len(before), np.pi)
    if len(start):
        rotated = np.column_stack([_rotate_and_zoom(start, end), np.ones(len(start))])
        rotated /= np.linalg.norm(rotated, axis=1, keepdims=True)
        angles[is_visible] = np.linalg.norm(np.cross(after[is_visible], rotated), axis=1)
    return angles


def _rotate_and_zoom(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the start points moved by the best rotation and focal length.

    All points are (N, 2): image positions divided by the stated focal length.
    """
    rotation, log_focal, weights = np.eye(3), 0.0, np.ones(len(start))
    for round_number in range(MAPPING.rotation_steps):
        focal = np.exp(log_focal)
        x, y, z = (np.column_stack([start / focal, np.ones(len(start))]) @ rotation.T).T
        z = np.maximum(z, MIN_Z)
        u, v = x / z, y / z
        rotated = focal * np.column_stack([u, v])
        residual = end - rotated
        distance = np.hypot(*residual.T)
        if round_number:
            weights = 1 / (distance + MAPPING.match_noise)
        # Derivatives of the projection by a rotation (ω × ray) from the left, and by log f.
        rotation_jacobian = focal * np.stack(
            [np.column_stack([-u * v, -1 - v * v]), np.column_stack([1 + u * u, u * v]),
             np.column_stack([-v, u])], axis=2,
        )  # fmt: skip
        ray_derivative = -start / focal @ rotation[:, :2].T  # d(ray)/d(log f)
        focal_jacobian = focal * np.column_stack(
            [
                u + (ray_derivative[:, 0] - u * ray_derivative[:, 2]) / z,
                v + (ray_derivative[:, 1] - v * ray_derivative[:, 2]) / z,
            ]
        )
        jacobian = np.concatenate([rotation_jacobian, focal_jacobian[:, :, None]], axis=2)
        weighted = jacobian * weights[:, None, None]
        matrix = np.einsum("nik,nil->kl", weighted, jacobian)
        vector = np.einsum("nik,ni->k", weighted, residual)
        matrix += 1e-9 * np.trace(matrix) * np.eye(4) + 1e-30 * np.eye(4)
        step = np.linalg.solve(matrix, vector)
        free_log_focal = log_focal + step[3]
        next_log_focal = float(
            np.clip(
                free_log_focal, np.log(MAPPING.min_focal_ratio), np.log(MAPPING.max_focal_ratio)
            )
        )
        if next_log_focal != free_log_focal:
            # The focal length is at its limit: the step of the rotation is solved for alone.
            vector = vector - matrix[:, 3] * (next_log_focal - log_focal)
            step = np.r_[np.linalg.solve(matrix[:3, :3], vector[:3]), next_log_focal - log_focal]
        rotation = _rotation(step[:3]) @ rotation
        log_focal = next_log_focal
        if round_number and np.abs(step).max() < MAPPING.min_rotation_step:
            break
    return rotated


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
        self._valid_points: set[int] = set()  # points that are seen from several positions

    def delete_points(self, view_id: int) -> None:
        """Delete the points of a view that are seen from one camera position only.

        A deleted point may be triangulated again with a view from another position.
        """
        images, points = self._reconstruction.images, self._reconstruction.points3D
        image = images[view_id]
        # Without repetition, since the track of a point may contain two observations of one view.
        point_ids = list(
            dict.fromkeys(point.point3D_id for point in image.points2D if point.has_point3D())
        )
        if not point_ids:
            return
        pose = image.cam_from_world().matrix()
        depth = (
            np.array([points[point_id].xyz for point_id in point_ids]) @ pose[2, :3] + pose[2, 3]
        )
        min_distance = MAPPING.min_baseline * float(np.median(depth))
        position = image.projection_center()
        distances: dict[int, float] = {}
        for point_id in point_ids:
            if point_id in self._valid_points:
                continue
            views = [element.image_id for element in points[point_id].track.elements]
            for view in views:
                if view not in distances:
                    baseline = images[view].projection_center() - position
                    distances[view] = float(np.linalg.norm(baseline))
            if max(distances[view] for view in views) >= min_distance:
                self._valid_points.add(point_id)
            else:
                self._mapper.observation_manager.delete_point3D(point_id)
