"""The camera's motion from matched points, for frames too far apart for a flow field."""

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from tisfm.camera import Camera
from tisfm.motion.epipolar_fit import (
    FreeUnknowns,
    Pose,
    Rays,
    essential_poses,
    length,
    nearest_points,
    pose_cost,
    refine_pose,
    robust_deviation,
    rotation_alone,
    rotation_residual,
)
from tisfm.motion.homographies import angle_between, plane_poses, sample_homographies
from tisfm.motion.settings import SPARSE
from tisfm.motion.sparse_matches import Matches

# For the information criterion GRIC:
COORDINATES = 4  # coordinates of a match in both frames
MAX_VARIANCES = 2.0  # largest squared error for each predicted coordinate, in variances

Model = Literal["rotation", "plane", "depth"]
_Motion = tuple[np.ndarray, np.ndarray, float]  # R, t and the residual, px
_AnyMotion = TypeVar("_AnyMotion", Pose, _Motion)


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseMotion:
    """A rigid motion fitted to matches, P₁ = R P₀ + t."""

    # rotation, translation: (3, 3) and (3,) float64: ‖t‖ = 1
    rotation: np.ndarray
    translation: np.ndarray
    rotation_alone: np.ndarray  # (3, 3) float64: the rotation that fits best without translation
    # The simplest model that explains the matches: a rotation, the homography of a plane, or a
    # depth for every point. All motions of a pair have the same model.
    model: Model
    residual: float  # robust standard deviation of the distances from epipolar lines, px
    parallax: float  # median length of the displacements that `rotation_alone` leaves, px
    inliers: int  # number of matches that the motion explains
    coverage: float  # share of the image's cells that contain an inlier
    cost: float  # robust cost of all matches; all motions of the pair have the same scale
    rays: Rays  # the inliers

    def scaled(self, factor: float) -> "SparseMotion":
        """Return the motion with its lengths, px, multiplied by a factor, for another level."""
        return replace(self, residual=factor * self.residual, parallax=factor * self.parallax)


def sparse_motions(
    matches: Matches,
    camera: Camera,  # without distortion
    shape: tuple[int, int],  # height and width of the frames, px
) -> tuple[list[SparseMotion], "MatchCost | None"]:
    """Return the motions that explain the matches, the likeliest first.

    Robust distances from epipolar lines are minimised from several starts: essential matrices by
    random sampling, and decompositions of homographies. If the matches lie on one plane, they
    determine no essential matrix, and the homography gives the motion. Two motions may then remain.

    Returns the motions, none if too few matches agree on a motion; and the cost of any motion on
    the same scale, None without a motion.

    References
    ----------
    As in `tisfm.motion.egomotion.camera_motion`; Torr, "Geometric motion segmentation and model
    selection", Phil. Trans. R. Soc. A 356 (1998), doi 10.1098/rsta.1998.0224; Malis and Vargas,
    "Deeper understanding of the homography decomposition for vision-based control", INRIA report
    6303, 2007.
    """
    if len(matches.points0) < SPARSE.min_matches:
        return [], None
    rays = _rays(matches, camera, shape)
    homographies = sample_homographies(rays)
    starts = essential_poses(rays, SPARSE.inlier_distances, draws=SPARSE.max_draws)
    for homography in homographies:
        starts += plane_poses(homography, rays.rays0)
    starts = _without_duplicates(starts)
    motions = [
        motion
        for distances in SPARSE.round_distances
        for motion in _refine_poses(rays, starts, distances)
    ]
    if not motions:
        return [], None
    scale = max(min(residual for _, _, residual in motions), SPARSE.min_residual)
    match_cost = MatchCost(rays=rays, scale=scale)
    motions.sort(key=lambda motion: match_cost.cost(motion[:2]))
    model = _select_model(rays, motions[0][:2], homographies, scale)
    max_cost = SPARSE.max_cost_ratio * match_cost.cost(motions[0][:2])
    unique_motions: list[_Motion] = []
    for motion in motions:
        if match_cost.cost(motion[:2]) <= max_cost and all(
            angle_between(motion[1], other[1]) >= SPARSE.min_translation_angle
            for other in unique_motions
        ):
            unique_motions.append(motion)
    return [
        _sparse_motion(match_cost, motion, model, camera, shape) for motion in unique_motions
    ], match_cost


def known_pose_motion(
    # matches, camera, shape: as in `sparse_motions`
    matches: Matches,
    camera: Camera,
    shape: tuple[int, int],
    pose: Pose,  # (rotation, translation): ‖t‖ = 1
) -> SparseMotion | None:
    """Return a known motion with its inliers, or None if too few matches agree with it."""
    if len(matches.points0) < SPARSE.min_matches:
        return None
    rays = _rays(matches, camera, shape)
    inliers = rays.select(_is_inlier(rays, pose, SPARSE.max_inlier_distance))
    if inliers.trust.size < SPARSE.min_matches:
        return None
    residual = robust_deviation(np.abs(nearest_points(inliers, *pose).distance), inliers.trust)
    match_cost = MatchCost(rays=rays, scale=max(residual, SPARSE.min_residual))
    return _sparse_motion(match_cost, (*pose, residual), "depth", camera, shape)


def pose_residual(rays: Rays, pose: Pose) -> float:
    """Return the robust distance of rays from the epipolar lines of a motion, px."""
    points = nearest_points(rays, *pose)
    # If the nearest point lies behind the camera, the point at infinity takes its place.
    distance = np.where(
        points.inverse_depth > 0,
        np.abs(points.distance),
        rays.focal * length(rotation_residual(rays, pose[0])),
    )
    return robust_deviation(distance, rays.trust)


@dataclass(frozen=True, kw_only=True)
class MatchCost:
    """The robust cost of any motion over all matches."""

    rays: Rays  # all matches
    scale: float  # scale of their distances from epipolar lines, px

    def cost(self, pose: Pose) -> float:
        """Return the robust cost of a motion; a match that the motion does not explain costs 1."""
        return pose_cost(self.rays, pose, self.scale)


def _rays(matches: Matches, camera: Camera, shape: tuple[int, int]) -> Rays:
    center = camera.center_for(*shape)
    rays0, rays1 = (
        (points - center).T / camera.focal for points in (matches.points0, matches.points1)
    )
    count = rays0.shape[1]
    return Rays(
        rays0=np.vstack([rays0, np.ones(count)]),
        rays1=rays1,
        trust=np.ones(count),
        focal=camera.focal,
    )


def _refine_poses(rays: Rays, starts: list[Pose], distances: tuple[float, ...]) -> list[_Motion]:
    """Return motions, without duplicates, refined on nearby matches, and their residuals."""
    unknowns = FreeUnknowns(count=6, likely_rotation=None)
    poses: list[Pose] = starts
    motions: list[_Motion] = []
    for k, distance in enumerate(distances):
        min_step = SPARSE.min_early_step if k + 1 < len(distances) else SPARSE.min_step
        motions = []
        for pose in poses:
            inliers = rays.select(_is_inlier(rays, pose, distance))
            if inliers.trust.size >= SPARSE.min_matches:
                motions.append(
                    refine_pose(
                        inliers, pose, unknowns, iterations=SPARSE.iterations, min_step=min_step
                    )
                )
        motions = _without_duplicates(motions)
        poses = [(rotation, translation) for rotation, translation, _ in motions]
    return [
        motion
        for motion in motions
        if np.count_nonzero(_is_inlier(rays, motion[:2], SPARSE.max_inlier_distance))
        >= SPARSE.min_matches
    ]


def _without_duplicates(motions: list[_AnyMotion]) -> list[_AnyMotion]:
    """Return the motions without motions that hardly differ from an earlier motion."""
    unique_motions: list[_AnyMotion] = []
    for motion in motions:
        if all(
            np.abs(motion[0] - other[0]).max() > SPARSE.max_duplicate_difference
            or np.abs(motion[1] - other[1]).max() > SPARSE.max_duplicate_difference
            for other in unique_motions
        ):
            unique_motions.append(motion)
    return unique_motions


def _is_inlier(rays: Rays, pose: Pose, max_distance: float) -> np.ndarray:
    """Return which matches lie near their epipolar line and in front of the camera, (N,)."""
    points = nearest_points(rays, *pose)
    return (np.abs(points.distance) <= max_distance) & (points.inverse_depth > 0)


def _sparse_motion(
    match_cost: MatchCost, motion: _Motion, model: Model, camera: Camera, shape: tuple[int, int]
) -> SparseMotion:
    rotation, translation, residual = motion
    rays = match_cost.rays
    inliers = rays.select(_is_inlier(rays, (rotation, translation), SPARSE.max_inlier_distance))
    pure_rotation = rotation_alone(inliers)
    return SparseMotion(
        rotation=rotation,
        translation=translation,
        rotation_alone=pure_rotation,
        model=model,
        residual=residual,
        parallax=camera.focal * float(np.median(length(rotation_residual(inliers, pure_rotation)))),
        inliers=inliers.trust.size,
        coverage=_coverage(inliers, camera, shape),
        cost=match_cost.cost((rotation, translation)),
        rays=inliers,
    )


def _coverage(rays: Rays, camera: Camera, shape: tuple[int, int]) -> float:
    """Return the share of the image's cells that contain a match."""
    height, width = shape
    center = np.array(camera.center_for(height, width))[:, None]
    points = rays.rays0[:2] * camera.focal + center + 0.5
    column, row = (points * SPARSE.coverage_cells / np.array([[width], [height]])).astype(np.int64)
    return len(np.unique(row * SPARSE.coverage_cells + column)) / SPARSE.coverage_cells**2


def _select_model(rays: Rays, pose: Pose, homographies: list[np.ndarray], scale: float) -> Model:
    """Return the model of least geometric robust information criterion (GRIC; Torr 1998).

    Errors are distances in frame 1 from a predicted point (rotation, plane) or line (depth).
    """
    distance = nearest_points(rays, *pose).distance
    criteria: dict[Model, float] = {
        "depth": _gric(distance**2, scale, dimension=3, parameters=5),
        "rotation": _gric(
            _homography_errors(rays, rotation_alone(rays)), scale, dimension=2, parameters=3
        ),
    }
    planes = [
        _gric(_homography_errors(rays, matrix), scale, dimension=2, parameters=8)
        for matrix in homographies
    ]
    if planes:
        criteria["plane"] = min(planes)
    return min(criteria, key=lambda model: criteria[model])


def _homography_errors(rays: Rays, matrix: np.ndarray) -> np.ndarray:
    """Return the squared distances of matches from the points of a homography, (N,) px²."""
    return rays.focal**2 * np.square(rotation_residual(rays, matrix)).sum(axis=0)


def _gric(squares: np.ndarray, scale: float, *, dimension: int, parameters: int) -> float:
    """Return GRIC: the errors plus the penalties for dimension and parameters of the model."""
    max_error = MAX_VARIANCES * (COORDINATES - dimension)
    fit = float(np.minimum(squares / scale**2, max_error).sum())
    count = squares.size
    return (
        fit + dimension * count * math.log(COORDINATES) + parameters * math.log(COORDINATES * count)
    )
