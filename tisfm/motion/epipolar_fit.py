"""Rigid motions from corresponding rays, by robust distances from epipolar lines."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.motion.settings import EGOMOTION
from tisfm.visibility.confidence import median

# standard deviation of a normal distribution divided by its median absolute value
MAD_TO_DEVIATION = 1.4826
MIN_STIFFNESS = 1e-9  # share of the trace of normal equations that is added to their diagonal
MIN_TRACE = 1e-30  # smallest trace of normal equations
# Smallest divisors: length and square of a normalised vector, and a median normalised displacement
MIN_LENGTH = 1e-9
MIN_SQUARE = 1e-18
MIN_DISPLACEMENT = 1e-12
Pose = tuple[np.ndarray, np.ndarray]  # R and t


@dataclass(frozen=True, kw_only=True)
class Rays:
    """Corresponding rays of two frames, a coordinate in each row."""

    rays0: np.ndarray  # (3, N) float64: (x̂, ŷ, 1) in frame 0
    rays1: np.ndarray  # (2, N) float64: (x̂, ŷ) in frame 1
    trust: np.ndarray  # (N,) float64: weight of each ray
    # focal length, px; rays of several cameras, (M, 3, N) and (M, 2, N), have focal lengths (M, 1)
    focal: float

    @property
    def is_confident(self) -> np.ndarray:
        """Rays that essential matrices are drawn from, (N,) bool."""
        return self.trust > EGOMOTION.min_confidence

    def select(self, mask: np.ndarray) -> "Rays":
        """Return the rays of a mask, (N,) bool."""
        rays0, rays1, trust = (array[..., mask] for array in (self.rays0, self.rays1, self.trust))
        return Rays(rays0=rays0, rays1=rays1, trust=trust, focal=self.focal)

    def subsample(self, stride: int) -> "Rays":
        """Return every `stride`-th ray."""
        rays0, rays1, trust = (
            np.ascontiguousarray(array[..., ::stride])
            for array in (self.rays0, self.rays1, self.trust)
        )
        return Rays(rays0=rays0, rays1=rays1, trust=trust, focal=self.focal)

    def of_cameras(self, rows: np.ndarray) -> "Rays":
        """Return the rays of some of several cameras."""
        focal = np.asarray(self.focal)[rows]
        return replace(self, rays0=self.rays0[rows], rays1=self.rays1[rows], focal=focal)

    def as_single(self) -> "Rays":
        """Return the rays in single precision."""
        rays0, rays1, trust = (
            array.astype(np.float32) for array in (self.rays0, self.rays1, self.trust)
        )
        return Rays(rays0=rays0, rays1=rays1, trust=trust, focal=self.focal)


@dataclass(frozen=True, kw_only=True)
class EpipolarPoints:
    """The points of epipolar lines that are nearest to the rays of frame 1, (N,) each."""

    inverse_depth: np.ndarray  # inverse depth d of the point in frame 0
    # x, y, nearness: normalised coordinates of the point R x̂ + d t, and 1/(its third component)
    x: np.ndarray
    y: np.ndarray
    nearness: np.ndarray
    # normal_x, normal_y: normal of the line, of length 1
    normal_x: np.ndarray
    normal_y: np.ndarray
    distance: np.ndarray  # signed distance of the ray from the line, px


@dataclass(frozen=True, kw_only=True)
class FreeUnknowns:
    """The number of free unknowns, the first of (t, ω), and a likely rotation."""

    count: int
    likely_rotation: np.ndarray | None


def rotation_prior(
    rotation: np.ndarray, likely_rotation: np.ndarray, noise: float
) -> tuple[float, np.ndarray]:
    """Return stiffness and offset, rad, of a prior that pulls a rotation to a likely rotation.

    The prior is a normal distribution of deviation `rotation_deviation`. The weight of the data
    assumes that every group of `correlated_pixels` pixels has one common error of `noise` px.
    """
    offset = cv2.Rodrigues(likely_rotation @ rotation.T)[0][:, 0]
    return EGOMOTION.correlated_pixels * (noise / EGOMOTION.rotation_deviation) ** 2, offset


def fix_scale(
    matrix: np.ndarray,  # (…, 6, 6): matrix of normal equations for a step in (t, ω)
    direction: np.ndarray,  # (…, 3): direction of t, of length 1
) -> np.ndarray:
    """Return a regular matrix of normal equations.

    A step along t changes the scale. The data do not determine the scale, so added terms keep it.
    """
    along = np.concatenate([direction, np.zeros_like(direction)], axis=-1)
    regularisation = along[..., :, None] * along[..., None, :] + MIN_STIFFNESS * np.eye(6)
    trace = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(matrix + (trace + MIN_TRACE) * regularisation)


def _rows(vectors: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the coordinates of vectors, (…, K, N), as K arrays, (…, N)."""
    return tuple(vectors[..., k, :] for k in range(vectors.shape[-2]))


def _components(vector: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the coordinates of a vector, (…, K), as K arrays, (…, 1)."""
    return tuple(vector[..., k, None] for k in range(vector.shape[-1]))


def triangulate_rays(
    rotated_rays: np.ndarray, rays1: np.ndarray, translation: np.ndarray
) -> np.ndarray:
    """Return the inverse depth, (…, N), that moves R x̂, (…, 3, N), nearest to rays (…, 2, N)."""
    # With p = R x̂ + d t, x̂₁ p₃ = p₁ and ŷ₁ p₃ = p₂ are linear in d.
    t_x, t_y, t_z = _components(translation)
    x0, y0, z0 = _rows(rotated_rays)
    x1, y1 = _rows(rays1)
    slope_x = t_x - x1 * t_z
    slope_y = t_y - y1 * t_z
    numerator = (x1 * z0 - x0) * slope_x
    numerator += (y1 * z0 - y0) * slope_y
    return numerator / np.maximum(slope_x * slope_x + slope_y * slope_y, MIN_SQUARE)


def essential_poses(
    rays: Rays,
    # px: largest distance of an inlier from the epipolar line, for each matrix
    thresholds: tuple[float, ...],
    *,
    draws: int,  # largest number of samples of five rays for a matrix
) -> list[Pose]:
    """Return the poses of essential matrices by random sampling; all of them may be wrong.

    The smaller of the two rotations of a matrix is taken, because frames are close in time.

    References
    ----------
    As in `tisfm.motion.egomotion.camera_motion`.
    """
    poses: list[Pose] = []
    rays0, rays1 = rays.rays0[:2].T.copy(), rays.rays1.T.copy()
    identity, no_distortion = np.eye(3), np.zeros(5)
    for threshold in thresholds:
        parameters = usac_parameters(threshold / rays.focal, draws)
        try:
            matrix, _ = cv2.findEssentialMat(
                rays0, rays1, identity, identity, no_distortion, no_distortion, parameters
            )
        except cv2.error:  # the samples determine no matrix
            continue
        if matrix is None or matrix.shape[0] < 3 or not np.isfinite(matrix).all():
            continue
        rotation0, rotation1, direction = cv2.decomposeEssentialMat(matrix[:3])
        rotation = rotation0 if np.trace(rotation0) > np.trace(rotation1) else rotation1
        poses.append((np.asarray(rotation, np.float64), np.asarray(direction[:, 0], np.float64)))
    return poses


def usac_parameters(threshold: float, draws: int) -> cv2.UsacParams:
    """Return settings of OpenCV's random sampling, with a fixed seed."""
    parameters = cv2.UsacParams()
    parameters.confidence = 0.9999
    parameters.maxIterations = draws
    parameters.sampler = cv2.SAMPLING_UNIFORM
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_INNER_LO
    parameters.loIterations, parameters.loSampleSize = 10, 50
    parameters.randomGeneratorState = 0
    parameters.threshold = threshold
    return parameters


def refine_pose(
    rays: Rays,
    start: Pose,
    unknowns: FreeUnknowns,
    *,
    iterations: int,
    min_step: float = EGOMOTION.min_step,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Minimise the robust distances from epipolar lines; return pose and scale of distances, px.

    A step shorter than `min_step` (rad, and of ‖t‖ = 1) ends the iterations.
    """
    count = unknowns.count
    rotation, translation = start
    scale = 0.0
    for _ in range(iterations):
        points = nearest_points(rays, rotation, translation)
        if rays.trust @ np.sign(points.inverse_depth) < 0:
            translation = -translation
            points = nearest_points(rays, rotation, translation)
        distance, jacobian = points.distance, distance_jacobian(points, rays.focal)
        scale = max(robust_deviation(np.abs(distance), rays.trust), EGOMOTION.min_scale)
        weight = rays.trust / (1 + (distance / (2 * scale)) ** 2) ** 2
        # Points behind the camera are wrong.
        weight *= np.where(points.inverse_depth > 0, 1.0, 0.2)
        matrix = (jacobian * weight) @ jacobian.T
        matrix = fix_scale(matrix, translation)
        gradient = jacobian @ (weight * distance)
        if unknowns.likely_rotation is not None:
            stiffness, offset = rotation_prior(rotation, unknowns.likely_rotation, scale)
            matrix[3:, 3:] += stiffness * np.eye(3)
            gradient[3:] += stiffness * offset
        step = np.zeros(6)
        step[:count] = np.linalg.solve(matrix[:count, :count], gradient[:count])
        # SciPy's Rotation rounds differently: in one of 24 checks, object motions changed by 2e-4.
        rotation_step = cv2.Rodrigues(step[3:])[0]
        rotation = rotation_step @ rotation
        translation = rotation_step @ translation + step[:3]
        translation = translation / np.linalg.norm(translation)
        if np.linalg.norm(step) < min_step:
            break
    return rotation, translation, scale


def pose_cost(rays: Rays, pose: Pose, scale: float) -> float:
    """Return the robust cost (Geman–McClure) of a pose at a common scale, px."""
    points = nearest_points(rays, *pose)
    square = (points.distance / (2 * scale)) ** 2
    return float(rays.trust @ np.where(points.inverse_depth > 0, square / (1 + square), 1.0))


def nearest_points(rays: Rays, rotation: np.ndarray, translation: np.ndarray) -> EpipolarPoints:
    """Return the points of the epipolar lines of a pose that are nearest to the rays.

    Several poses, (M, 3, 3) and (M, 3), give arrays (M, N). They may have rays of their own, with
    one focal length each, (M, 1).
    """
    rotated_rays = rotation @ rays.rays0
    inverse_depth = triangulate_rays(rotated_rays, rays.rays1, translation)
    t_x, t_y, t_z = _components(translation)
    x0, y0, z0 = _rows(rotated_rays)
    x1, y1 = _rows(rays.rays1)
    nearness = 1 / np.maximum(z0 + inverse_depth * t_z, MIN_DEPTH_RATIO)
    x = (x0 + inverse_depth * t_x) * nearness
    y = (y0 + inverse_depth * t_y) * nearness
    normal_x, normal_y = y * t_z - t_y, t_x - x * t_z
    reciprocal_length = 1 / np.maximum(
        np.sqrt(normal_x * normal_x + normal_y * normal_y), MIN_LENGTH
    )
    normal_x *= reciprocal_length
    normal_y *= reciprocal_length
    return EpipolarPoints(
        inverse_depth=inverse_depth,
        x=x,
        y=y,
        nearness=nearness,
        normal_x=normal_x,
        normal_y=normal_y,
        distance=rays.focal * (normal_x * (x1 - x) + normal_y * (y1 - y)),
    )


def distance_jacobian(points: EpipolarPoints, focal: float | np.ndarray) -> np.ndarray:
    """Return the negative derivatives of distances by translation and rotation, (…, 6, N), px."""
    x, y = points.x, points.y
    a, b = focal * points.normal_x, focal * points.normal_y
    radial_part = a * x + b * y
    translation_factor = points.inverse_depth * points.nearness
    jacobian = np.empty((*x.shape[:-1], 6, x.shape[-1]))
    by_translation_x, by_translation_y, by_translation_z, by_turn_x, by_turn_y, by_turn_z = _rows(
        jacobian
    )
    # A point P moves by δP = δT + δω × P, divided by its depth and projected.
    np.multiply(translation_factor, a, out=by_translation_x)
    np.multiply(translation_factor, b, out=by_translation_y)
    np.multiply(-translation_factor, radial_part, out=by_translation_z)
    np.multiply(-y, radial_part, out=by_turn_x)
    by_turn_x -= b
    np.multiply(x, radial_part, out=by_turn_y)
    by_turn_y += a
    np.subtract(b * x, a * y, out=by_turn_z)
    return jacobian


def find_direction_covariance(
    rays: Rays,
    pose: Pose,  # the motion that fits the rays best, ‖t‖ = 1
    *,
    independent_rays: float,  # rays with independent errors; neighbours share errors of the flow
    min_scale: float,  # px: smallest deviation of the distances from epipolar lines
) -> np.ndarray:
    """Return the covariance of the direction of translation, (3, 3), by a robust fit."""
    points = nearest_points(rays, *pose)
    scale = max(robust_deviation(np.abs(points.distance), rays.trust), min_scale)
    weight = rays.trust / (1 + (points.distance / (2 * scale)) ** 2) ** 2
    weight *= independent_rays / (scale**2 * weight.size)
    jacobian = distance_jacobian(points, rays.focal)
    matrix = fix_scale((jacobian * weight) @ jacobian.T, pose[1])
    return np.asarray(np.linalg.inv(matrix)[:3, :3])


def rotation_alone(rays: Rays) -> np.ndarray:
    """Return the rotation, (3, 3), that fits the displacements best without translation."""
    rotation = np.eye(3)
    for _ in range(10):
        residual = rotation_residual(rays, rotation)
        x, y = rays.rays1 - residual
        distance = length(residual)
        weight = 1 / np.maximum(distance, max(median(distance), MIN_DISPLACEMENT))  # Huber's
        derivative_x = np.stack([-x * y, 1 + x * x, -y])
        derivative_y = np.stack([-1 - y * y, x * y, x])
        matrix = (derivative_x * weight) @ derivative_x.T + (derivative_y * weight) @ derivative_y.T
        gradient = derivative_x @ (weight * residual[0]) + derivative_y @ (weight * residual[1])
        try:
            step = np.linalg.solve(matrix, gradient)
        except np.linalg.LinAlgError:  # the rays are nearly parallel
            break
        rotation = cv2.Rodrigues(step)[0] @ rotation
        if np.linalg.norm(step) < EGOMOTION.min_step:
            break
    return rotation


def rotation_residual(rays: Rays, rotation: np.ndarray) -> np.ndarray:
    """Return the displacements that a rotation leaves, (2, N), normalised."""
    rotated_rays = rotation @ rays.rays0
    return rays.rays1 - rotated_rays[:2] / rotated_rays[2]


def length(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors, (2, N)."""
    return np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1])


def robust_deviation(distances: np.ndarray, weights: np.ndarray) -> float:
    """Return a standard deviation from the weighted median of absolute distances, (N,)."""
    return MAD_TO_DEVIATION * _weighted_median(distances, weights)


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    weight_sums = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(weight_sums, 0.5 * weight_sums[-1])])
