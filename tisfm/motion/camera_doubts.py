"""Whether another camera explains a flow field better: a zoom, a lens, or another focal length."""

import cv2
import numpy as np

from tisfm.motion.camera_search import CameraSearch, measure_changes, search_cameras
from tisfm.motion.camera_settings import INTRINSICS
from tisfm.motion.epipolar_fit import (
    MIN_LENGTH,
    MIN_STIFFNESS,
    Pose,
    Rays,
    find_direction_covariance,
    length,
    nearest_points,
    robust_deviation,
    rotation_residual,
)
from tisfm.motion.focal_evidence import FocalEvidence, weigh_focal
from tisfm.status import Status
from tisfm.visibility.confidence import median


def examine_camera(
    rays: Rays,  # of a flow field
    pose: Pose,  # the motion that fits the rays best, ‖t‖ = 1
    rotation: np.ndarray,  # (3, 3): the rotation that fits them best without a translation
) -> tuple[Status | None, FocalEvidence]:
    """Return a status if the rays contradict the stated camera, and what the focal length does."""
    sample = rays.subsample(max(1, rays.trust.size // INTRINSICS.max_rays))
    searches = search_cameras(sample, pose, rotation)
    evidence = weigh_focal(sample, pose, searches[0])
    residual = robust_deviation(np.abs(nearest_points(sample, *pose).distance), sample.trust)
    if _may_only_turn(sample, residual, rotation):
        doubt = Status(
            "contradicted",
            "the camera may only have turned: a turn with another focal length or lens explains "
            "the image motion as well, so depth is probably wrong; give the true camera, with its "
            "distortion, or move the camera between the frames",
        )
        return doubt, evidence
    significant = [search for search in searches if _is_better(sample, pose, search)]
    if significant:
        best = max(significant, key=lambda search: search.gain)
        return _contradicted_status(best), evidence
    direction_deviation = measure_direction_deviation(sample, pose)
    if direction_deviation > INTRINSICS.max_direction_deviation:
        doubt = Status(
            "uncertain",
            f"the direction of motion is known to ±{min(direction_deviation, 90):.0f}° only, "
            "because the image moves little beyond a turn: take frames farther apart, or move the "
            "camera sideways",
        )
        return doubt, evidence
    return None, evidence


def measure_direction_deviation(
    rays: Rays,  # of a flow field, some hundred
    pose: Pose,  # the motion that fits the rays best, ‖t‖ = 1
) -> float:
    """Return the standard deviation of the direction of translation, degrees, where it is worst."""
    covariance = find_direction_covariance(
        rays,
        pose,
        independent_rays=INTRINSICS.independent_rays,
        min_scale=INTRINSICS.min_direction_residual,
    )
    largest = float(np.linalg.eigvalsh(covariance)[-1])
    return float(np.degrees(np.sqrt(max(largest, 0.0))))


def _is_better(rays: Rays, pose: Pose, search: CameraSearch) -> bool:
    """Return whether another camera is clearly better, and changes the result."""
    if not search.is_significant:
        return False
    changes = measure_changes(rays, pose, search.best)
    return bool(
        changes.depth[0] > INTRINSICS.min_depth_change
        or changes.direction[0] > INTRINSICS.min_direction_change
    )


def _contradicted_status(search: CameraSearch) -> Status:
    value = search.best_value
    if search.parameter == "focal":
        text = f"with a focal length that is {np.exp(value):.2g} times as long"
        advice = "give the true focal length"
    elif search.parameter == "zoom":
        text = f"with a zoom of {100 * np.expm1(value):+.2g} % from frame 0 to frame 1"
        advice = "check the focal length, or take frames without a zoom"
    else:
        text = f"with a radial distortion of k₁ = {value:.2g}"
        advice = (
            "check the focal length, and give the lens as Camera(distortion=…); "
            'tisfm.reconstruct(calibrate="radial") estimates it from a sequence'
        )
    return Status(
        "contradicted",
        f"the image motion contradicts the camera: it fits better {text}, so motion and depth are "
        f"probably wrong; {advice}",
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
        and measure_turning_residual(rays, rotation, limit=limit) < limit
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
    *,
    limit: float = 0.0,  # px: a smaller residual ends the fit
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
        before, found = (
            found,
            min(found, robust_deviation(distance, rays.trust) / float(np.sqrt(2))),
        )
        if found < limit or found > INTRINSICS.max_turn_gain * before:
            break
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
