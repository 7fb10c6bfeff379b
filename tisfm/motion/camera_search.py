"""Search for a camera that explains a flow field better than the stated camera.

A parameter of the camera is changed step by step. The motion follows in each step, so that it stays
near the best motion. For other focal lengths, motions are tried that may be far from the motion of
the stated one. From the best step, parameter and motion are refined jointly.

All cameras of a step are computed at once: arrays have one row for each of M cameras.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.motion.epipolar_fit import (
    MAD_TO_DEVIATION,
    EpipolarPoints,
    Pose,
    Rays,
    distance_jacobian,
    fix_scale,
    nearest_points,
)
from tisfm.motion.homographies import find_near_plane, plane_poses
from tisfm.motion.settings import INTRINSICS
from tisfm.visibility.confidence import median

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
    def of(cls, parameter: Parameter, values: list[float], poses: list[Pose]) -> "Cameras":
        """Return cameras with several values of one parameter, and a motion for each."""
        return cls(
            parameters=(parameter,) * len(values),
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


@dataclass(frozen=True, kw_only=True)
class CameraSearch:
    """The values of one parameter that were tried."""

    parameter: Parameter
    tried: Cameras  # the stated camera, cameras whose motion follows, and others
    costs: np.ndarray  # (M,): robust costs, in squared standard deviations of independent rays
    best: Cameras  # one camera
    best_cost: float
    deviation: float  # standard deviation of the best value

    @property
    def best_value(self) -> float:
        """The best value of the parameter."""
        return float(self.best.values[0])

    @property
    def gain(self) -> float:
        """Standard deviations by which the best camera explains the rays better."""
        return float(np.sqrt(max(self.costs[0] - self.best_cost, 0.0)))

    @property
    def significance(self) -> float:
        """Standard deviations of the best value from 0."""
        return abs(self.best_value) / self.deviation

    @property
    def is_significant(self) -> bool:
        """Whether the best camera explains the rays clearly better."""
        return self.gain > INTRINSICS.min_gain and self.significance > INTRINSICS.min_significance


@dataclass(frozen=True, kw_only=True)
class Changes:
    """What other cameras change in the result of the stated camera, (M,) each."""

    depth: np.ndarray  # median relative change, up to scale; infinite if half change sides
    direction: np.ndarray  # rad: of the translation
    rotation: np.ndarray  # rad

    def select(self, rows: np.ndarray) -> "Changes":
        """Return the changes by some of the cameras."""
        return Changes(
            depth=self.depth[rows], direction=self.direction[rows], rotation=self.rotation[rows]
        )


def search_cameras(
    rays: Rays,  # of a flow field, some hundred
    pose: Pose,  # the motion that fits the rays best with the stated camera, ‖t‖ = 1
    rotation: np.ndarray,  # (3, 3): the rotation that fits them best without a translation
) -> list[CameraSearch]:
    """Search for the values of all parameters, and the motions, that explain rays best."""
    stated = replace(Cameras.of("focal", [0.0] * 3, [pose] * 3), parameters=PARAMETERS)
    tried = _follow(rays, pose) + _try_other_motions(rays, pose, rotation)
    tried = stated + _improve(rays, tried, is_free=False)[0]
    points = _points(rays, tried)
    deviations = _robust_deviations(np.abs(points.distance), rays.trust)
    groups = tried.groups
    scales = np.array([deviations[groups == group].min() for group in range(len(PARAMETERS))])
    scales = np.maximum(scales, INTRINSICS.min_residual)
    costs = _costs(points, rays, tried, scales)
    starts = [
        int(rows[np.argmin(costs[rows])])
        for group in range(len(PARAMETERS))
        for sign in (1, -1)
        for rows in [np.flatnonzero((groups == group) & (sign * tried.values > 0))]
    ]
    refined = _refine(rays, tried.select(np.array(starts)))
    found, found_costs = (
        tried + refined,
        np.concatenate([costs, _costs(_points(rays, refined), rays, refined, scales)]),
    )
    searches = []
    for group, parameter in enumerate(PARAMETERS):
        rows = np.flatnonzero(found.groups == group)
        best = rows[[np.argmin(found_costs[rows])]]
        _, deviation = _improve(rays, found.select(best), is_free=True)
        rows = rows[rows < len(costs)]
        searches.append(
            CameraSearch(
                parameter=parameter,
                tried=tried.select(rows),
                costs=costs[rows],
                best=found.select(best),
                best_cost=float(found_costs[best[0]]),
                deviation=float(deviation[0]),
            )
        )
    return searches


def measure_changes(rays: Rays, pose: Pose, cameras: Cameras) -> Changes:
    """Return what other cameras change in the result of the stated camera, whose pose is given."""
    before, after = nearest_points(rays, *pose).inverse_depth, _points(rays, cameras).inverse_depth
    is_ahead = (before > 0) & (after > 0)
    depth = np.full(len(after), np.inf)
    for row, ahead in enumerate(is_ahead):
        if 2 * np.count_nonzero(ahead) >= before.size:
            ratio = after[row, ahead] / before[ahead]
            depth[row] = median(np.abs(ratio / median(ratio) - 1))
    return Changes(
        depth=depth,
        direction=np.arccos(np.clip(cameras.translations @ pose[1], -1, 1)),
        rotation=Rotation.from_matrix(cameras.rotations @ pose[0].T).magnitude(),
    )


def _follow(rays: Rays, pose: Pose) -> Cameras:
    """Return cameras of all values, whose motions follow from value to value.

    The smallest values of a parameter come first.
    """
    signs = np.array([1.0, -1.0])
    current = Cameras.of("focal", [0.0] * 6, [pose] * 6)
    current = replace(current, parameters=tuple(name for name in PARAMETERS for _ in signs))
    found = current.select(np.array([], np.intp))
    for step in range(max(map(len, STEPS.values()))):
        rows = [row for row, name in enumerate(current.parameters) if step < len(STEPS[name])]
        current = current.select(np.array(rows))
        sizes = np.array([STEPS[name][step] for name in current.parameters])
        current = replace(current, values=sizes * np.tile(signs, len(sizes) // 2))
        current, _ = _improve(rays, current, is_free=False)
        found += current
    return found


def _try_other_motions(rays: Rays, pose: Pose, rotation: np.ndarray) -> Cameras:
    """Return focal lengths with motions that may be far from the motion of the stated one.

    If the scene is nearly a plane, these are the motions of the plane; if the camera mainly turns,
    it is a translation that the turn leaves.
    """
    homography = find_near_plane(rays, pose)
    turn = Rotation.from_matrix(rotation).as_rotvec()
    values, starts = [], []
    for value in (sign * value for value in STEPS["focal"] for sign in (1, -1)):
        changed = _change_focal(rays, value)
        smaller_turn = Rotation.from_rotvec(turn * np.exp(-value)).as_matrix()
        poses = [(smaller_turn, _remaining_direction(changed, smaller_turn))]
        if homography is not None:
            scale = np.diag([np.exp(-value), np.exp(-value), 1.0])
            poses += plane_poses(scale @ homography @ np.linalg.inv(scale), changed)
        starts += poses
        values += [value] * len(poses)
    cameras = Cameras.of("focal", values, starts)
    for _ in range(INTRINSICS.other_iterations):
        cameras, _ = _improve(rays, cameras, is_free=False)
    return cameras


def _change_focal(rays: Rays, value: float) -> Rays:
    """Return rays with another focal length; `value` is its logarithm over the stated one."""
    factor = float(np.exp(-value))
    return Rays(
        rays0=np.vstack([rays.rays0[:2] * factor, rays.rays0[2:]]),
        rays1=rays.rays1 * factor,
        trust=rays.trust,
        focal=rays.focal / factor,
    )


def _remaining_direction(rays: Rays, rotation: np.ndarray) -> np.ndarray:
    """Return the direction of translation, (3,), that fits rays best after a rotation."""
    rays1 = np.vstack([rays.rays1, np.ones(rays.trust.size)])
    normals = np.cross(rotation @ rays.rays0, rays1, axis=0) * rays.trust
    return np.asarray(np.linalg.eigh(normals @ normals.T)[1][:, 0])


def _refine(rays: Rays, cameras: Cameras) -> Cameras:
    """Return cameras whose values and motions were improved jointly."""
    largest = INTRINSICS.max_overshoot * np.array([max(STEPS[name]) for name in cameras.parameters])
    for _ in range(INTRINSICS.joint_iterations):
        cameras, _ = _improve(rays, cameras, is_free=True)
        cameras = replace(cameras, values=np.clip(cameras.values, -largest, largest))
    return cameras


def _improve(rays: Rays, cameras: Cameras, *, is_free: bool) -> tuple[Cameras, np.ndarray]:
    """Return cameras with better motions, and the standard deviations of their values, (M,).

    Free values are improved as well; the deviations of other values are infinite.
    """
    changed = _change_cameras(rays, cameras)
    translations = cameras.translations
    points = nearest_points(changed, cameras.rotations, translations)
    is_behind = np.sign(points.inverse_depth) @ rays.trust < 0
    if is_behind.any():
        translations = np.where(is_behind[:, None], -translations, translations)
        points = nearest_points(changed, cameras.rotations, translations)
    distance = points.distance
    scales = np.maximum(_robust_deviations(np.abs(distance), rays.trust), INTRINSICS.min_residual)
    weight = rays.trust / (1 + (distance / (2 * scales[:, None])) ** 2) ** 2
    weight *= np.where(points.inverse_depth > 0, 1.0, INTRINSICS.weight_behind)
    weight *= (INTRINSICS.independent_rays / (scales**2 * rays.trust.size))[:, None]
    jacobian = distance_jacobian(points, changed.focal)
    if is_free:
        derivative = _derivatives(changed, points, cameras)
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


def _change_cameras(rays: Rays, cameras: Cameras) -> Rays:
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
        factor[is_distortion] = _undistort((x * x).sum(axis=0), values[is_distortion])
    moved0 = x0 * factor0[:, None]
    return Rays(
        rays0=np.concatenate([moved0, np.ones_like(moved0[:, :1])], axis=1),
        rays1=x1 * factor1[:, None],
        trust=rays.trust,
        focal=rays.focal / np.where(is_focal[:, None], shrinking, 1.0),
    )


def _undistort(square: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return factors of points without the distortion k₁, (M, N); `square` is r² of the points."""
    undistorted = square
    for _ in range(INTRINSICS.undistortion_iterations):
        scale = np.maximum(1 + values * undistorted, INTRINSICS.min_distortion)
        undistorted = square / scale**2
    return np.asarray(1 / scale)


def _derivatives(rays: Rays, points: EpipolarPoints, cameras: Cameras) -> np.ndarray:
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


def _points(rays: Rays, cameras: Cameras) -> EpipolarPoints:
    return nearest_points(_change_cameras(rays, cameras), cameras.rotations, cameras.translations)


def _robust_deviations(distances: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return standard deviations from weighted medians of absolute distances, (M, N)."""
    order = np.argsort(distances, axis=1)
    sums = np.cumsum(weights[order], axis=1)
    middle = np.argmax(sums >= 0.5 * sums[:, -1:], axis=1)
    rows = np.arange(len(distances))
    return np.asarray(MAD_TO_DEVIATION * distances[rows, order[rows, middle]])


def _costs(
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
