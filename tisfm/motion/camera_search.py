"""Search for a camera that explains a flow field better than the stated camera.

A parameter of the camera is changed step by step. The motion follows in each step, so that it stays
near the best motion. For other focal lengths, motions are tried that may be far from the motion of
the stated one. From the best step, parameter and motion are refined jointly.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.motion.camera_fit import (
    PARAMETERS,
    STEPS,
    Cameras,
    Parameter,
    find_points,
    improve_cameras,
    measure_costs,
    robust_deviations,
)
from tisfm.motion.camera_settings import INTRINSICS
from tisfm.motion.epipolar_fit import Pose, Rays, nearest_points
from tisfm.motion.homographies import find_near_plane, plane_poses
from tisfm.visibility.confidence import median


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
    *,
    focal_only: bool = False,  # whether the other parameters are left out
) -> list[CameraSearch]:
    """Search for the values of parameters, and the motions, that explain rays best.

    The focal length comes first.
    """
    parameters = PARAMETERS[:1] if focal_only else PARAMETERS
    stated = Cameras.of(parameters, [0.0] * len(parameters), [pose] * len(parameters))
    tried = _follow(rays, pose, parameters) + _try_other_motions(rays, pose, rotation)
    tried = stated + improve_cameras(rays, tried, is_free=False)[0]
    points = find_points(rays, tried)
    deviations = robust_deviations(np.abs(points.distance), rays.trust)
    groups = tried.groups
    scales = np.array([deviations[groups == group].min() for group in range(len(parameters))])
    scales = np.maximum(scales, INTRINSICS.min_residual)
    costs = measure_costs(points, rays, tried, scales)
    starts = []  # the best of each parameter and sign
    for group in range(len(parameters)):
        for sign in (1, -1):
            rows = np.flatnonzero((groups == group) & (sign * tried.values > 0))
            starts.append(rows[np.argmin(costs[rows])])
    refined = _refine(rays, tried.select(np.array(starts)))
    refined_costs = measure_costs(find_points(rays, refined), rays, refined, scales)
    found, found_costs = tried + refined, np.concatenate([costs, refined_costs])
    searches = []
    for group, parameter in enumerate(parameters):
        rows = np.flatnonzero(found.groups == group)
        best = rows[[np.argmin(found_costs[rows])]]
        _, deviation = improve_cameras(rays, found.select(best), is_free=True)
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
    before = nearest_points(rays, *pose).inverse_depth
    after = find_points(rays, cameras).inverse_depth
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


def _follow(rays: Rays, pose: Pose, parameters: tuple[Parameter, ...]) -> Cameras:
    """Return cameras of all values, whose motions follow from value to value.

    The smallest values of a parameter come first.
    """
    signs = np.array([1.0, -1.0])
    names = [name for name in parameters for _ in signs]
    current = Cameras.of(names, [0.0] * len(names), [pose] * len(names))
    found = current.select(np.array([], np.intp))
    for step in range(max(map(len, STEPS.values()))):
        rows = [row for row, name in enumerate(current.parameters) if step < len(STEPS[name])]
        current = current.select(np.array(rows))
        sizes = np.array([STEPS[name][step] for name in current.parameters])
        current = replace(current, values=sizes * np.tile(signs, len(sizes) // 2))
        current, _ = improve_cameras(rays, current, is_free=False)
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
    cameras = Cameras.of(["focal"] * len(values), values, starts)
    for _ in range(INTRINSICS.other_iterations):
        cameras, _ = improve_cameras(rays, cameras, is_free=False)
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
        cameras, _ = improve_cameras(rays, cameras, is_free=True)
        cameras = replace(cameras, values=np.clip(cameras.values, -largest, largest))
    return cameras
