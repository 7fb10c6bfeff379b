"""Whether another camera explains a flow field better: a zoom, a lens, or another focal length."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from tisfm.motion.epipolar_fit import (
    MIN_LENGTH,
    MIN_STIFFNESS,
    EpipolarPoints,
    Pose,
    Rays,
    distance_jacobian,
    fix_scale,
    length,
    nearest_points,
    robust_deviation,
    rotation_residual,
)
from tisfm.motion.settings import INTRINSICS
from tisfm.status import Status
from tisfm.visibility.confidence import median

Parameter = Literal["zoom", "distortion"]
PARAMETERS: tuple[Parameter, ...] = ("zoom", "distortion")


@dataclass(frozen=True, kw_only=True)
class CameraFit:
    """A parameter of the camera, fitted jointly with a motion."""

    parameter: Parameter
    value: float  # logarithm of the zoom between the frames, or k₁ of both frames
    significance: float  # standard deviations from 0
    residual: float  # px: robust deviation of the distances from epipolar lines
    pose: Pose  # the motion, ‖t‖ = 1


def find_camera_doubt(
    rays: Rays,  # of a flow field
    pose: Pose,  # the motion that fits the rays best, ‖t‖ = 1
    rotation: np.ndarray,  # (3, 3): the rotation that fits them best without a translation
) -> Status | None:
    """Return a status if the rays contradict the stated camera, else None."""
    sample = rays.subsample(max(1, rays.trust.size // INTRINSICS.max_rays))
    residual = robust_deviation(np.abs(nearest_points(sample, *pose).distance), sample.trust)
    if _may_only_turn(sample, residual, rotation):
        return Status(
            "contradicted",
            "the camera may only have turned: a turn with another focal length or lens explains "
            "the image motion as well, so depth is probably wrong; give the true camera, with its "
            "distortion, or move the camera between the frames",
        )
    # a noisy flow has a large residual, too, but fits in the mean of a region
    is_thorough = (
        residual > INTRINSICS.max_quiet_residual
        and measure_misfit(rays, pose) > INTRINSICS.max_quiet_misfit
    )
    fits = [fit_camera(sample, pose, name, is_thorough=is_thorough) for name in PARAMETERS]
    fit = max(fits, key=lambda fit: fit.significance)
    if (
        fit.significance < INTRINSICS.min_significance
        or _depth_change(sample, pose, fit) < INTRINSICS.min_depth_change
    ):
        return None
    if fit.parameter == "zoom":
        text = f"with a zoom of {100 * np.expm1(fit.value):+.2g} % from frame 0 to frame 1"
        advice = "check the focal length, or take frames without a zoom"
    else:
        text = f"with a radial distortion of k₁ = {fit.value:.2g}"
        advice = (
            "check the focal length, and give the lens as Camera(distortion=…); "
            'tisfm.reconstruct(calibrate="radial") estimates it from a sequence'
        )
    return Status(
        "contradicted",
        f"the image motion contradicts the camera: it fits better {text}, so motion and depth are "
        f"probably wrong; {advice}",
    )


def fit_camera(rays: Rays, pose: Pose, parameter: Parameter, *, is_thorough: bool) -> CameraFit:
    """Fit a motion and one parameter of the camera to rays.

    A thorough fit has several starts, because a wrong motion may be a local minimum. Other fits end
    after one iteration if the parameter is not significant.
    """
    other_start = getattr(INTRINSICS, f"{parameter}_start")
    starts = (0.0, -other_start, other_start) if is_thorough else (0.0,)
    fits = [_fit_from(rays, pose, parameter, start, may_end=not is_thorough) for start in starts]
    return min(fits, key=lambda fit: fit.residual)


def _fit_from(
    rays: Rays, pose: Pose, parameter: Parameter, value: float, *, may_end: bool
) -> CameraFit:
    """Fit a motion and a parameter of the camera, which starts from a value."""
    rotation, translation = pose
    deviation = getattr(INTRINSICS, f"{parameter}_deviation")
    largest = INTRINSICS.max_deviations * deviation
    significance = scale = 0.0
    for _ in range(INTRINSICS.iterations):
        changed = _change_camera(rays, parameter, value)
        points = nearest_points(changed, rotation, translation)
        derivative = _camera_derivative(changed, points, rotation, parameter)
        jacobian = np.vstack([distance_jacobian(points, rays.focal), derivative])
        scale = max(robust_deviation(np.abs(points.distance), rays.trust), INTRINSICS.min_residual)
        weight = rays.trust / (1 + (points.distance / (2 * scale)) ** 2) ** 2
        weight *= INTRINSICS.independent_rays / (scale**2 * weight.size)
        matrix = (jacobian * weight) @ jacobian.T
        matrix[:6, :6] = fix_scale(matrix[:6, :6], translation)
        matrix[6, 6] += 1 / deviation**2
        gradient = jacobian @ (weight * points.distance)
        gradient[6] -= value / deviation**2
        step = np.linalg.solve(matrix, gradient)
        turn = cv2.Rodrigues(step[3:6])[0]
        rotation, translation = turn @ rotation, turn @ translation + step[:3]
        translation = translation / np.linalg.norm(translation)
        value = float(np.clip(value + step[6], -largest, largest))
        significance = abs(value) / float(np.sqrt(np.linalg.inv(matrix)[6, 6]))
        if may_end and significance < INTRINSICS.min_first_significance:
            break
    return CameraFit(
        parameter=parameter,
        value=value,
        significance=significance,
        residual=scale,
        pose=(rotation, translation),
    )


def _depth_change(rays: Rays, pose: Pose, fit: CameraFit) -> float:
    """Return the median relative change of depth, up to scale, by a parameter of the camera."""
    before = nearest_points(rays, *pose).inverse_depth
    changed = _change_camera(rays, fit.parameter, fit.value)
    after = nearest_points(changed, *fit.pose).inverse_depth
    is_ahead = (before > 0) & (after > 0)
    if 2 * np.count_nonzero(is_ahead) < len(before):
        return np.inf
    ratio = after[is_ahead] / before[is_ahead]
    return median(np.abs(ratio / median(ratio) - 1))


def _change_camera(rays: Rays, parameter: Parameter, value: float) -> Rays:
    """Return rays without a zoom or a distortion."""
    x0, x1 = rays.rays0[:2], rays.rays1
    if parameter == "zoom":
        factor0, factor1 = 1.0, np.exp(-value)
    else:
        factor0, factor1 = (1 - value * (x * x).sum(axis=0) for x in (x0, x1))
    return Rays(
        rays0=np.vstack([x0 * factor0, rays.rays0[2:]]),
        rays1=x1 * factor1,
        trust=rays.trust,
        focal=rays.focal,
    )


def _camera_derivative(
    rays: Rays, points: EpipolarPoints, rotation: np.ndarray, parameter: Parameter
) -> np.ndarray:
    """Return the negative derivatives of distances by a parameter of the camera, (N,), px."""
    x0, x1 = rays.rays0[:2], rays.rays1
    change0, change1 = (
        (np.zeros_like(x0), x1)
        if parameter == "zoom"
        else (x0 * (x0 * x0).sum(axis=0), x1 * (x1 * x1).sum(axis=0))
    )
    moved = rotation[:, :2] @ change0
    moved_x, moved_y = (moved[:2] - np.stack([points.x, points.y]) * moved[2]) * points.nearness
    return np.asarray(
        rays.focal
        * (points.normal_x * (change1[0] - moved_x) + points.normal_y * (change1[1] - moved_y))
    )


def _may_only_turn(rays: Rays, residual: float, rotation: np.ndarray) -> bool:
    """Return whether a turn of another camera explains the rays nearly as well as a motion."""
    parallax = rays.focal * median(length(rotation_residual(rays, rotation)))
    limit = min(
        INTRINSICS.max_turn_residual * max(residual, INTRINSICS.min_turn_residual),
        INTRINSICS.max_turn_share * parallax,
    )
    return (
        _polynomial_residual(rays, rotation) < limit
        and measure_turning_residual(rays, rotation) < limit
    )


def _polynomial_residual(rays: Rays, rotation: np.ndarray) -> float:
    """Return the residual of a flow that is a polynomial of the position, px.

    Turns of any camera are nearly such polynomials, so a turn can hardly leave less.
    """
    residual = rays.focal * rotation_residual(rays, rotation)
    x, y = rays.rays0[:2] / max(float(np.abs(rays.rays0[:2]).max()), MIN_LENGTH)
    degree = INTRINSICS.turn_degree
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])
    weighted = terms * rays.trust
    matrix = weighted @ terms.T
    matrix += MIN_STIFFNESS * np.trace(matrix) * np.eye(len(terms))
    rest = residual - np.linalg.solve(matrix, weighted @ residual.T).T @ terms
    return robust_deviation(length(rest), rays.trust) / float(np.sqrt(2))


def measure_turning_residual(
    rays: Rays,
    rotation: np.ndarray,  # (3, 3): where the fit starts
) -> float:
    """Return the residual of a turn with any focal length and distortion, px.

    It is the robust deviation of the displacements that the turn leaves, of one component.
    """
    parameters = np.zeros(2)  # logarithm of the focal length, and k₁
    square0, square1 = ((x * x).sum(axis=0) for x in (rays.rays0[:2], rays.rays1))
    found = np.inf
    for _ in range(INTRINSICS.turn_iterations):
        focal, distortion = parameters
        scale0, scale1 = (
            np.exp(-focal) * (1 - distortion * square) for square in (square0, square1)
        )
        changed0, changed1 = rays.rays0[:2] * scale0, rays.rays1 * scale1
        rotated = rotation @ np.vstack([changed0, np.ones_like(square0)])
        nearness = 1 / rotated[2]
        x, y = rotated[:2] * nearness
        residual = changed1 - rotated[:2] * nearness
        # px of the stated camera
        distance = rays.focal * np.exp(focal) * length(residual)
        found = min(found, robust_deviation(distance, rays.trust) / float(np.sqrt(2)))
        noise = max(median(distance), INTRINSICS.min_turn_residual)
        weight = rays.trust / (1 + (distance / (2 * noise)) ** 2) ** 2
        # derivatives of `residual`, negated
        turned = rotation[:, :2] @ changed0
        by_focal = changed1 - (turned[:2] - np.stack([x, y]) * turned[2]) * nearness
        turned = turned * square0
        by_lens = changed1 * square1 - (turned[:2] - np.stack([x, y]) * turned[2]) * nearness
        by_rotation = [
            np.stack([-x * y, -1 - y * y]), np.stack([1 + x * x, x * y]), np.stack([-y, x])
        ]  # fmt: skip
        jacobian = np.stack([*by_rotation, by_focal, by_lens]).reshape(5, -1)
        weights = np.tile(weight, 2)
        matrix = (jacobian * weights) @ jacobian.T
        prior = np.array([0, 0, 0, *(1 / np.square(INTRINSICS.turn_deviations))])
        prior *= weight.sum() / INTRINSICS.independent_rays * (noise / rays.focal) ** 2
        matrix += np.diag(prior) + MIN_STIFFNESS * np.trace(matrix) * np.eye(5)
        gradient = jacobian @ (weights * residual.ravel())
        gradient[3:] -= prior[3:] * parameters
        step = np.linalg.solve(matrix, gradient)
        rotation = cv2.Rodrigues(step[:3])[0] @ rotation
        largest = INTRINSICS.max_turn_parameter
        parameters = np.clip(parameters + step[3:], -largest, largest)
        if np.linalg.norm(step) < INTRINSICS.min_turn_step:
            break
    return found


def find_misfit_doubt(
    rays: Rays,  # of a flow field
    pose: Pose,  # the motion that fits the rays best, ‖t‖ = 1
) -> Status | None:
    """Return a status if whole regions move off the epipolar lines of a motion, else None."""
    share = measure_misfit(rays, pose)
    if share < INTRINSICS.max_misfit:
        return None
    return Status(
        "uncertain",
        "regions of the image move off the lines that one motion allows, a quarter of them by "
        f"{100 * share:.0f}% of their parallax or more, so depth is rough: choose "
        'motion="objects" if objects move, and check the focal length and the lens',
    )


def measure_misfit(rays: Rays, pose: Pose) -> float:
    """Return the upper quartile over regions of the distance from epipolar lines over parallax.

    Noise averages out in a region. A wrong camera, a moving object and a wrong flow do not.
    """
    x, y = rays.rays0[:2]
    width, height = (float(np.ptp(values)) for values in (x, y))
    side = max(width, height, 1e-9) / INTRINSICS.regions
    columns, rows = (((values - values.min()) / side).astype(np.intp) for values in (x, y))
    region = rows * (INTRINSICS.regions + 1) + columns
    distance = nearest_points(rays, *pose).distance
    parallax = rays.focal * length(rotation_residual(rays, pose[0]))
    weight = np.where(rays.is_confident, rays.trust, 0)
    total, distances, parallaxes, counts = (
        np.bincount(region, weights)
        for weights in (weight, weight * distance, weight * parallax, weight > 0)
    )
    is_known = counts >= INTRINSICS.min_rays_of_region
    if not is_known.any():
        return 0.0
    least = INTRINSICS.min_parallax * total[is_known]
    ratio = np.abs(distances[is_known]) / np.maximum(parallaxes[is_known], least)
    return float(np.percentile(ratio, INTRINSICS.misfit_percentile))
