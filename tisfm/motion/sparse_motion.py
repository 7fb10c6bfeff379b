"""The camera's motion from matched points, for frames too far apart for a flow field."""

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.epipolar_fit import (
    Free,
    Pose,
    Rays,
    beyond,
    cost,
    essential_poses,
    length,
    nearest_points,
    refine,
    robust_deviation,
    rotation_alone,
    sampling,
)
from tisfm.motion.sparse_matches import Matches

THRESHOLDS = (0.5, 1.0, 2.0, 4.0)  # px: inliers, from the epipolar line or the homography's point
DRAWS = 10_000  # most random samples for a threshold: half of the matches may be wrong
# px: largest distances of the matches in each round of refinement, for two refinements of a start.
# Near matches alone miss the least cost from a poor start; far matches lead away from a good start.
REACHES = ((16.0, 6.0, 3.0), (3.0, 3.0))
# rad, and of ‖t‖ = 1: length of a step that ends the last round, and the rounds before it.
SETTLED, NEARLY_SETTLED = 1e-5, 1e-3
ALIKE = 1e-3  # largest difference of an entry of R or t between two motions that count as the same
EXPLAINED = 3.0  # px: largest distance of an inlier
ITERATIONS = 30  # most iterations of a round
FEWEST = 12  # matches within reach: five fit any motion, and wrong matches add a few by chance
SMALLEST_RESIDUAL = 0.3  # px: accuracy of a detected point
TIED = 1.3  # ratio to the least robust cost up to which other motions may be right as well
SAME = 0.2  # rad: smallest angle between the translations of two different motions
SPREAD_CELLS = 8  # cells along each side of the image
# The information criterion: coordinates of a match, and the largest squared error of a match, in
# variances for each coordinate that the model predicts.
COORDINATES, WORST = 4, 2.0

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
    spread: float  # share of the image's cells that hold an inlier
    cost: float  # robust cost of all matches, with one scale for all motions of the pair
    rays: Rays  # the inliers

    def scaled(self, factor: float) -> "SparseMotion":
        """Return the motion with its lengths, px, multiplied for another level."""
        return replace(self, residual=factor * self.residual, parallax=factor * self.parallax)


def sparse_motions(
    matches: Matches,
    camera: Camera,  # without distortion
    shape: tuple[int, int],  # height and width of the frames, px
) -> tuple[list[SparseMotion], "Judge | None"]:
    """Return the motions that explain the matches, the likeliest first.

    Robust distances from epipolar lines are minimised from several starts: essential matrices by
    random sampling, and decompositions of homographies. If the matches lie on one plane, they
    determine no essential matrix, and the homography gives the motion. Two motions may then remain.

    Returns motions, empty if too few matches agree on a motion; judge, the cost of other motions on
    the same scale; None if no motion was found.

    References
    ----------
    As in `tisfm.motion.egomotion.camera_motion`; Torr, "Geometric motion segmentation and model
    selection", Phil. Trans. R. Soc. A 356 (1998), doi 10.1098/rsta.1998.0224; Malis and Vargas,
    "Deeper understanding of the homography decomposition for vision-based control", INRIA report
    6303, 2007.
    """
    if len(matches.before) < FEWEST:
        return [], None
    rays = _rays(matches, camera, shape)
    homographies = _homographies(rays)
    starts = essential_poses(rays, THRESHOLDS, draws=DRAWS)
    for homography in homographies:
        starts += of_plane(homography, rays)
    starts = _distinct(starts)
    found = [motion for reaches in REACHES for motion in _polished(rays, starts, reaches)]
    if not found:
        return [], None
    scale = max(min(residual for _, _, residual in found), SMALLEST_RESIDUAL)
    judge = Judge(rays=rays, scale=scale)
    found.sort(key=lambda motion: judge.cost(motion[:2]))
    model = _model(rays, found[0][:2], homographies, scale)
    limit = TIED * judge.cost(found[0][:2])
    kept: list[_Motion] = []
    for motion in found:
        if judge.cost(motion[:2]) <= limit and all(
            angle(motion[1], other[1]) >= SAME for other in kept
        ):
            kept.append(motion)
    return [_described(judge, motion, model, camera, shape) for motion in kept], judge


def posed_motion(
    # matches, camera, shape: as in `sparse_motions`
    matches: Matches,
    camera: Camera,
    shape: tuple[int, int],
    pose: Pose,  # (rotation, translation): ‖t‖ = 1
) -> SparseMotion | None:
    """Return a known motion with its inliers, or None if too few matches agree with it."""
    if len(matches.before) < FEWEST:
        return None
    rays = _rays(matches, camera, shape)
    near = rays.where(_explained(rays, pose, EXPLAINED))
    if near.trust.size < FEWEST:
        return None
    residual = robust_deviation(np.abs(nearest_points(near, *pose).distance), near.trust)
    judge = Judge(rays=rays, scale=max(residual, SMALLEST_RESIDUAL))
    return _described(judge, (*pose, residual), "depth", camera, shape)


def posed_residual(rays: Rays, pose: Pose) -> float:
    """Return the robust deviation of rays from the points that a motion allows, px."""
    nearest = nearest_points(rays, *pose)
    # If the nearest point lies behind the camera, the point at infinity is the nearest allowed one.
    distance = np.where(
        nearest.inverse_depth > 0,
        np.abs(nearest.distance),
        rays.focal * length(beyond(rays, pose[0])),
    )
    return robust_deviation(distance, rays.trust)


@dataclass(frozen=True, kw_only=True)
class Judge:
    """The robust cost of any motion over all matches."""

    rays: Rays  # all matches
    scale: float  # scale of their distances from epipolar lines, px

    def cost(self, pose: Pose) -> float:
        """Return the robust cost of a motion. A match that it does not explain costs 1."""
        return cost(self.rays, pose, self.scale)


def _rays(matches: Matches, camera: Camera, shape: tuple[int, int]) -> Rays:
    center = camera.center_for(*shape)
    before, after = (
        (points - center).T / camera.focal for points in (matches.before, matches.after)
    )
    count = before.shape[1]
    return Rays(
        before=np.vstack([before, np.ones(count)]),
        after=after,
        trust=np.ones(count),
        focal=camera.focal,
    )


def _homographies(rays: Rays) -> list[np.ndarray]:
    """Return homographies of normalised coordinates by random sampling, (3, 3) each."""
    # OpenCV finds no homography for small coordinates, so it gets px.
    before, after = (rays.focal * points[:2].T for points in (rays.before, rays.after))
    to_px = np.diag([rays.focal, rays.focal, 1.0])
    found = []
    for threshold in THRESHOLDS:
        try:
            matrix, _ = cv2.findHomography(before, after, sampling(threshold, DRAWS))
        except cv2.error:  # the samples determine no homography
            continue
        if matrix is not None and matrix.shape == (3, 3) and np.isfinite(matrix).all():
            found.append(np.linalg.solve(to_px, matrix @ to_px))
    return found


def of_plane(
    homography: np.ndarray,  # (3, 3): for normalised coordinates
    rays: Rays,
    *,
    share: float = 0.5,  # least share of the rays that meet the plane before the camera
) -> list[Pose]:
    """Return the motions that may have caused a homography: their plane lies before the camera."""
    _, rotations, translations, normals = cv2.decomposeHomographyMat(homography, np.eye(3))
    poses: list[Pose] = []
    for rotation, translation, normal in zip(rotations, translations, normals, strict=True):
        away = float(np.linalg.norm(translation))
        if away > 0 and np.quantile(normal[:, 0] @ rays.before, 1 - share) > 0:
            poses.append((np.asarray(rotation), np.asarray(translation[:, 0]) / away))
    return poses


def _polished(rays: Rays, starts: list[Pose], reaches: tuple[float, ...]) -> list[_Motion]:
    """Return motions refined by the matches near them, and their residuals, without duplicates."""
    free = Free(unknowns=6, near=None)
    poses: list[Pose] = starts
    found: list[_Motion] = []
    for k, reach in enumerate(reaches):
        settled = NEARLY_SETTLED if k + 1 < len(reaches) else SETTLED
        found = []
        for pose in poses:
            near = rays.where(_explained(rays, pose, reach))
            if near.trust.size >= FEWEST:
                found.append(refine(near, pose, free, iterations=ITERATIONS, settled=settled))
        found = _distinct(found)
        poses = [(rotation, translation) for rotation, translation, _ in found]
    return [
        motion
        for motion in found
        if np.count_nonzero(_explained(rays, motion[:2], EXPLAINED)) >= FEWEST
    ]


def _distinct(motions: list[_AnyMotion]) -> list[_AnyMotion]:
    """Return the motions without duplicates: at most `ALIKE` from an earlier motion."""
    kept: list[_AnyMotion] = []
    for motion in motions:
        if all(
            np.abs(motion[0] - other[0]).max() > ALIKE or np.abs(motion[1] - other[1]).max() > ALIKE
            for other in kept
        ):
            kept.append(motion)
    return kept


def _explained(rays: Rays, pose: Pose, reach: float) -> np.ndarray:
    """Return which matches lie near their epipolar line and before the camera, (N,) bool."""
    nearest = nearest_points(rays, *pose)
    return (np.abs(nearest.distance) <= reach) & (nearest.inverse_depth > 0)


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Return the angle between two vectors of length 1, rad."""
    return float(np.arccos(np.clip(one @ other, -1, 1)))


def _described(
    judge: Judge,
    motion: _Motion,
    model: Model,
    camera: Camera,
    shape: tuple[int, int],
) -> SparseMotion:
    rotation, translation, residual = motion
    rays = judge.rays
    mine = rays.where(_explained(rays, (rotation, translation), EXPLAINED))
    alone = rotation_alone(mine)
    return SparseMotion(
        rotation=rotation,
        translation=translation,
        rotation_alone=alone,
        model=model,
        residual=residual,
        parallax=camera.focal * float(np.median(length(beyond(mine, alone)))),
        inliers=mine.trust.size,
        spread=_spread(mine, camera, shape),
        cost=judge.cost((rotation, translation)),
        rays=mine,
    )


def _spread(rays: Rays, camera: Camera, shape: tuple[int, int]) -> float:
    """Return the share of the image's cells that hold a match."""
    height, width = shape
    center = np.array(camera.center_for(height, width))[:, None]
    points = rays.before[:2] * camera.focal + center + 0.5
    column, row = (points * SPREAD_CELLS / np.array([[width], [height]])).astype(np.int64)
    return len(np.unique(row * SPREAD_CELLS + column)) / SPREAD_CELLS**2


def _model(rays: Rays, pose: Pose, homographies: list[np.ndarray], scale: float) -> Model:
    """Return the model of least geometric robust information criterion (GRIC; Torr 1998).

    Errors are distances in frame 1 from a predicted point (rotation, plane) or line (depth).
    """
    distance = nearest_points(rays, *pose).distance
    found: dict[Model, float] = {
        "depth": _criterion(distance**2, scale, dimension=3, parameters=5),
        "rotation": _criterion(
            _beyond_homography(rays, rotation_alone(rays)), scale, dimension=2, parameters=3
        ),
    }
    planes = [
        _criterion(_beyond_homography(rays, matrix), scale, dimension=2, parameters=8)
        for matrix in homographies
    ]
    if planes:
        found["plane"] = min(planes)
    return min(found, key=lambda model: found[model])


def _beyond_homography(rays: Rays, matrix: np.ndarray) -> np.ndarray:
    """Return the squared distances of matches from the points of a homography, (N,) px²."""
    return rays.focal**2 * np.square(beyond(rays, matrix)).sum(axis=0)


def _criterion(square: np.ndarray, scale: float, *, dimension: int, parameters: int) -> float:
    """Return GRIC: the errors plus the penalties for dimension and parameters of the model."""
    worst = WORST * (COORDINATES - dimension)
    fit = float(np.minimum(square / scale**2, worst).sum())
    count = square.size
    return (
        fit + dimension * count * math.log(COORDINATES) + parameters * math.log(COORDINATES * count)
    )
