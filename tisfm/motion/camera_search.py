"""Search for a camera that explains a flow field better than the stated camera.

A parameter of the camera is changed step by step. The motion follows in each step, so that it stays
near the best motion. For other focal lengths, motions are tried that may be far from the motion of
the stated one. From the best step, parameter and motion are refined jointly.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.motion.camera_fit import (
    LARGEST,
    PARAMETERS,
    STEPS,
    VALUES,
    Cameras,
    Parameter,
    change_cameras,
    find_lines,
    improve_cameras,
    make_turns,
    measure_costs,
    robust_deviations,
)
from tisfm.motion.camera_settings import INTRINSICS
from tisfm.motion.epipolar_fit import Pose, Rays, triangulate_rays
from tisfm.motion.homographies import find_near_plane, plane_poses


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
    rays = rays.as_single()
    parameters = PARAMETERS[:1] if focal_only else PARAMETERS
    stated = Cameras.of(parameters, [0.0] * len(parameters), [pose] * len(parameters))
    tried, changed = _try_values(rays, stated, _find_other_motions(rays, pose, rotation))
    lines = find_lines(changed, tried)
    deviations = robust_deviations(np.abs(lines.distances), rays.trust)
    groups = tried.groups
    scales = np.array([deviations[groups == group].min() for group in range(len(parameters))])
    scales = np.maximum(scales, INTRINSICS.min_residual)
    costs = measure_costs(lines, rays, tried, scales)
    starts = []  # the best of each parameter and sign
    for group in range(len(parameters)):
        for sign in (1, -1):
            rows = np.flatnonzero((groups == group) & (sign * tried.values > 0))
            starts.append(rows[np.argmin(costs[rows])])
    refined = _refine(rays, tried.select(np.array(starts)))
    lines = find_lines(change_cameras(rays, refined), refined)
    refined_costs = measure_costs(lines, rays, refined, scales)
    found, found_costs = Cameras.join([tried, refined]), np.concatenate([costs, refined_costs])
    rows_of = [np.flatnonzero(found.groups == group) for group in range(len(parameters))]
    best = np.array([rows[np.argmin(found_costs[rows])] for rows in rows_of])
    best_cameras = found.select(best)
    changed = change_cameras(rays, best_cameras)
    _, deviations = improve_cameras(changed, best_cameras, is_free=True)
    searches = []
    for group, (parameter, rows) in enumerate(zip(parameters, rows_of, strict=True)):
        rows = rows[rows < len(costs)]
        searches.append(
            CameraSearch(
                parameter=parameter,
                tried=tried.select(rows),
                costs=costs[rows],
                best=found.select(best[[group]]),
                best_cost=float(found_costs[best[group]]),
                deviation=float(deviations[group]),
            )
        )
    return searches


def measure_changes(rays: Rays, pose: Pose, cameras: Cameras) -> Changes:
    """Return what other cameras change in the result of the stated camera, whose pose is given."""
    before = triangulate_rays(pose[0] @ rays.rays0, rays.rays1, pose[1])
    changed = change_cameras(rays, cameras)
    moved = cameras.rotations @ changed.rays0
    after = triangulate_rays(moved, changed.rays1, cameras.translations)
    is_ahead = (before > 0) & (after > 0)
    with np.errstate(divide="ignore", invalid="ignore"):  # where a point is not ahead
        ratios = after / before
        ratios /= _find_medians(ratios, is_ahead)[:, None]
        depth = _find_medians(np.abs(ratios - 1), is_ahead)
    depth[2 * np.count_nonzero(is_ahead, axis=1) < before.size] = np.inf
    return Changes(
        depth=depth,
        direction=np.arccos(np.clip(cameras.translations @ pose[1], -1, 1)),
        rotation=Rotation.from_matrix(cameras.rotations @ pose[0].T).magnitude(),
    )


def _find_medians(values: np.ndarray, is_used: np.ndarray) -> np.ndarray:
    """Return the median of the used values of each row, (M, N).

    A row without used values gives an arbitrary number.
    """
    ordered = np.sort(np.where(is_used, values, np.inf), axis=1)
    counts = np.count_nonzero(is_used, axis=1)
    rows = np.arange(len(values))
    lower, upper = (
        ordered[rows, middle] for middle in (np.maximum(counts - 1, 0) // 2, counts // 2)
    )
    return np.asarray(0.5 * (lower + upper))


def _try_values(rays: Rays, stated: Cameras, far: Cameras) -> tuple[Cameras, Rays]:
    """Return the stated cameras and cameras of all values, and the rays of all of them.

    The motion of the stated camera follows from value to value; the smallest values of a parameter
    come first. Then come the cameras `far`, which are improved in the same steps: an operation on
    arrays takes little longer with more rows.
    """
    count, steps = 2 * len(stated.groups), VALUES.shape[1]
    near = stated.select(np.arange(count) // 2)
    signs = np.tile([1.0, -1.0], count // 2)
    near_values = np.concatenate([signs * VALUES[near.groups, step] for step in range(steps)])
    cameras = Cameras.join([stated, *[near] * steps, far])
    cameras = replace(cameras, values=np.concatenate([stated.values, near_values, far.values]))
    changed = change_cameras(rays, cameras)
    first, last = len(stated.groups), len(cameras.groups)
    first_far = last - len(far.groups)
    for step in range(steps):
        rows = np.arange(first + step * count, first + (step + 1) * count)
        if step:
            cameras.rotations[rows] = cameras.rotations[rows - count]
            cameras.translations[rows] = cameras.translations[rows - count]
        if step < INTRINSICS.other_iterations:
            rows = np.concatenate([rows, np.arange(first_far, last)])
        _improve_rows(changed, cameras, rows)
    _improve_rows(changed, cameras, np.arange(first, last))
    return cameras, changed


def _improve_rows(changed: Rays, cameras: Cameras, rows: np.ndarray) -> None:
    """Improve the motions of some of the cameras in place."""
    improved, _ = improve_cameras(changed.of_cameras(rows), cameras.select(rows), is_free=False)
    cameras.rotations[rows] = improved.rotations
    cameras.translations[rows] = improved.translations


def _find_other_motions(rays: Rays, pose: Pose, rotation: np.ndarray) -> Cameras:
    """Return focal lengths with motions that may be far from the motion of the stated one.

    If the scene is nearly a plane, these are the motions of the plane; if the camera mainly turns,
    it is a translation that the turn leaves.
    """
    homography = find_near_plane(rays, pose)
    values = np.outer(STEPS["focal"], (1, -1)).ravel()
    factors = np.exp(-values)
    turns = make_turns(factors[:, None] * cv2.Rodrigues(rotation)[0][:, 0])
    cameras = Cameras(
        groups=np.zeros(len(values), np.intp),
        values=values,
        rotations=turns,
        translations=np.zeros((len(values), 3)),
    )
    changed = change_cameras(rays, cameras)
    cameras = replace(cameras, translations=_find_remaining_directions(changed, turns))
    if homography is None:
        return cameras
    plane_values, poses = [], []
    for value, factor in zip(values, factors, strict=True):
        scale = np.array([factor, factor, 1.0])
        rays0 = rays.rays0 * scale[:, None]
        of_value = plane_poses(homography * scale[:, None] / scale, rays0)
        poses += of_value
        plane_values += [value] * len(of_value)
    if not poses:
        return cameras
    return Cameras.join([cameras, Cameras.of(["focal"] * len(poses), plane_values, poses)])


def _find_remaining_directions(rays: Rays, rotations: np.ndarray) -> np.ndarray:
    """Return the directions of translation, (M, 3), that fit rays of cameras after rotations."""
    x, y, z = np.swapaxes(rotations @ rays.rays0, 0, 1)
    x1, y1 = np.swapaxes(rays.rays1, 0, 1)
    normals = np.stack([y - z * y1, z * x1 - x, x * y1 - y * x1], axis=1) * rays.trust
    return np.asarray(np.linalg.eigh(normals @ np.swapaxes(normals, 1, 2))[1][:, :, 0])


def _refine(rays: Rays, cameras: Cameras) -> Cameras:
    """Return cameras whose values and motions were improved jointly."""
    largest = INTRINSICS.max_overshoot * LARGEST[cameras.groups]
    for _ in range(INTRINSICS.joint_iterations):
        before = cameras.values
        changed = change_cameras(rays, cameras)
        cameras, deviations = improve_cameras(changed, cameras, is_free=True)
        cameras = replace(cameras, values=np.clip(cameras.values, -largest, largest))
        change = np.abs(cameras.values - before)
        if (change < INTRINSICS.min_joint_step * deviations).all():
            break
    return cameras
