"""Cameras that differ from the stated one in one parameter, and motions that fit rays with them.

All M cameras are computed at once: arrays have one row for each of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.motion.camera_settings import INTRINSICS
from tisfm.motion.epipolar_fit import (
    MAD_TO_DEVIATION,
    EpipolarPoints,
    Pose,
    Rays,
    distance_jacobian,
    fix_scale,
    nearest_points,
)

# "focal": logarithm of the focal length of both frames over the stated one; "zoom": logarithm of
# the zoom from frame 0 to frame 1; "distortion": k₁ of both frames
Parameter = Literal["focal", "zoom", "distortion"]
PARAMETERS: tuple[Parameter, ...] = ("focal", "zoom", "distortion")
STEPS = {
    "focal": INTRINSICS.focal_values,
    "zoom": INTRINSICS.zoom_values,
    "distortion": INTRINSICS.distortion_values,
}
PRIORS = {
    "focal": INTRINSICS.focal_prior,
    "zoom": INTRINSICS.zoom_prior,
    "distortion": INTRINSICS.distortion_prior,
}


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """Cameras that differ from the stated one in one parameter each, and their motions."""

    parameters: tuple[Parameter, ...]  # M
    values: np.ndarray  # (M,)
    rotations: np.ndarray  # (M, 3, 3)
    translations: np.ndarray  # (M, 3): ‖t‖ = 1

    @classmethod
    def of(
        cls, parameters: Sequence[Parameter], values: Sequence[float], poses: Sequence[Pose]
    ) -> "Cameras":
        """Return cameras with a parameter, its value, and a motion for each."""
        return cls(
            parameters=tuple(parameters),
            values=np.array(values),
            rotations=np.stack([rotation for rotation, _ in poses]),
            translations=np.stack([translation for _, translation in poses]),
        )

    def __add__(self, other: "Cameras") -> "Cameras":
        """Return the cameras of both."""
        return Cameras(
            parameters=self.parameters + other.parameters,
            values=np.concatenate([self.values, other.values]),
            rotations=np.concatenate([self.rotations, other.rotations]),
            translations=np.concatenate([self.translations, other.translations]),
        )

    def select(self, rows: np.ndarray) -> "Cameras":
        """Return some of the cameras, by their numbers."""
        return Cameras(
            parameters=tuple(self.parameters[row] for row in rows),
            values=self.values[rows],
            rotations=self.rotations[rows],
            translations=self.translations[rows],
        )

    def are(self, parameter: Parameter) -> np.ndarray:
        """Return which cameras differ in a parameter, (M,) bool."""
        return np.array([own == parameter for own in self.parameters])

    @property
    def groups(self) -> np.ndarray:
        """Index into `PARAMETERS` of each camera, (M,)."""
        return np.array([PARAMETERS.index(own) for own in self.parameters], np.intp)

    @property
    def priors(self) -> np.ndarray:
        """Standard deviations of the values, (M,)."""
        return np.array([PRIORS[parameter] for parameter in self.parameters])


def improve_cameras(rays: Rays, cameras: Cameras, *, is_free: bool) -> tuple[Cameras, np.ndarray]:
    """Return cameras with better motions, and the standard deviations of their values, (M,).

    Free values are improved as well; the deviations of other values are infinite.
    """
    changed = change_cameras(rays, cameras)
    translations = cameras.translations
    points = nearest_points(changed, cameras.rotations, translations)
    is_behind = np.sign(points.inverse_depth) @ rays.trust < 0
    if is_behind.any():
        translations = np.where(is_behind[:, None], -translations, translations)
        points = nearest_points(changed, cameras.rotations, translations)
    distance = points.distance
    scales = np.maximum(robust_deviations(np.abs(distance), rays.trust), INTRINSICS.min_residual)
    weight = rays.trust / (1 + (distance / (2 * scales[:, None])) ** 2) ** 2
    weight *= np.where(points.inverse_depth > 0, 1.0, INTRINSICS.weight_behind)
    weight *= (INTRINSICS.independent_rays / (scales**2 * rays.trust.size))[:, None]
    jacobian = distance_jacobian(points, changed.focal)
    if is_free:
        derivative = find_derivatives(changed, points, cameras)
        jacobian = np.concatenate([jacobian, derivative[:, None]], axis=1)
    weighted = jacobian * weight[:, None]
    matrix = weighted @ np.swapaxes(jacobian, 1, 2)
    gradient = (weighted @ distance[..., None])[..., 0]
    matrix[:, :6, :6] = fix_scale(matrix[:, :6, :6], translations)
    values, deviations = cameras.values, np.full(len(cameras.values), np.inf)
    if is_free:
        stiffness = 1 / cameras.priors**2
        matrix[:, 6, 6] += stiffness
        gradient[:, 6] -= stiffness * values
        deviations = np.sqrt(np.linalg.inv(matrix)[:, 6, 6])
    step = np.linalg.solve(matrix, gradient[..., None])[..., 0]
    if is_free:
        values = values + step[:, 6]
    turns = Rotation.from_rotvec(step[:, 3:6]).as_matrix()
    translations = (turns @ translations[..., None])[..., 0] + step[:, :3]
    translations = translations / np.linalg.norm(translations, axis=1, keepdims=True)
    improved = replace(
        cameras, values=values, rotations=turns @ cameras.rotations, translations=translations
    )
    return improved, deviations


def change_cameras(rays: Rays, cameras: Cameras) -> Rays:
    """Return the rays of all cameras: (M, 3, N) and (M, 2, N), and focal lengths (M, 1)."""
    x0, x1 = rays.rays0[:2], rays.rays1
    values = cameras.values[:, None]
    is_focal, is_zoom, is_distortion = (cameras.are(parameter) for parameter in PARAMETERS)
    shrinking = np.exp(-values)
    factor0 = np.where(is_focal[:, None], shrinking, 1.0)
    factor1 = np.where((is_focal | is_zoom)[:, None], shrinking, 1.0)
    factor0, factor1 = (
        np.broadcast_to(factor, (len(values), rays.trust.size)).copy()
        for factor in (factor0, factor1)
    )
    for x, factor in ((x0, factor0), (x1, factor1)):
        factor[is_distortion] = undistort_points((x * x).sum(axis=0), values[is_distortion])
    moved0 = x0 * factor0[:, None]
    return Rays(
        rays0=np.concatenate([moved0, np.ones_like(moved0[:, :1])], axis=1),
        rays1=x1 * factor1[:, None],
        trust=rays.trust,
        focal=rays.focal / np.where(is_focal[:, None], shrinking, 1.0),  # type: ignore[arg-type]  # (M, 1)
    )


def undistort_points(square: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return factors of points without the distortion k₁, (M, N); `square` is r² of the points.

    The factor f solves f (1 + k₁ r² f²) = 1, by Newton's method. Beyond the radius where the
    distortion folds the image, the largest factor is returned.
    """
    strength = values * square
    factor = np.ones_like(strength)
    for _ in range(INTRINSICS.undistortion_iterations):
        slope = np.maximum(1 + 3 * strength * factor**2, INTRINSICS.min_distortion_slope)
        factor -= (factor * (1 + strength * factor**2) - 1) / slope
        factor = np.clip(factor, 0.0, INTRINSICS.max_undistortion)
    return factor


def find_derivatives(rays: Rays, points: EpipolarPoints, cameras: Cameras) -> np.ndarray:
    """Return the negative derivatives of distances by the values of cameras, (M, N), px."""
    x0, x1 = rays.rays0[:, :2], rays.rays1
    is_zoom, is_distortion = (
        cameras.are(parameter)[:, None, None] for parameter in ("zoom", "distortion")
    )
    square0, square1 = ((x * x).sum(axis=1, keepdims=True) for x in (x0, x1))
    change0 = x0 * np.where(is_zoom, 0.0, np.where(is_distortion, square0, 1.0))
    change1 = x1 * np.where(is_distortion, square1, 1.0)
    moved = cameras.rotations[:, :, :2] @ change0
    moved_x = (moved[:, 0] - points.x * moved[:, 2]) * points.nearness
    moved_y = (moved[:, 1] - points.y * moved[:, 2]) * points.nearness
    return np.asarray(
        rays.focal
        * (
            points.normal_x * (change1[:, 0] - moved_x)
            + points.normal_y * (change1[:, 1] - moved_y)
        )
    )


def find_points(rays: Rays, cameras: Cameras) -> EpipolarPoints:
    """Return the points of epipolar lines of all cameras, (M, N)."""
    return nearest_points(change_cameras(rays, cameras), cameras.rotations, cameras.translations)


def robust_deviations(distances: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return standard deviations from weighted medians of absolute distances, (M, N)."""
    order = np.argsort(distances, axis=1)
    sums = np.cumsum(weights[order], axis=1)
    middle = np.argmax(sums >= 0.5 * sums[:, -1:], axis=1)
    rows = np.arange(len(distances))
    return np.asarray(MAD_TO_DEVIATION * distances[rows, order[rows, middle]])


def measure_costs(
    points: EpipolarPoints,  # of the cameras, (M, N)
    rays: Rays,
    cameras: Cameras,
    scales: np.ndarray,  # px: deviations of the rays, for each of `PARAMETERS`
) -> np.ndarray:
    """Return robust costs (Geman–McClure) of cameras, (M,)."""
    square = (points.distance / (2 * scales[cameras.groups, None])) ** 2
    costs = np.where(points.inverse_depth > 0, square / (1 + square), 1.0)
    mean = costs @ rays.trust / rays.trust.sum()
    return np.asarray(
        4 * INTRINSICS.independent_rays * mean + (cameras.values / cameras.priors) ** 2
    )
