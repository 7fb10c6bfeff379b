"""The camera's motion from a flow field: where ``motion="camera"`` starts."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera, check_pinhole

SAMPLES = 5000  # pixels that take part: more hardly help, and all of them are neighbours
CONFIDENT = 0.1  # least confidence of those that the essential matrix is drawn from
THRESHOLDS = (0.05, 0.2, 0.8)  # px from the epipolar line, of inliers of essential matrices
FEW = 1000  # of the samples, by which the best of several starts is found
STARTING, ITERATIONS = 6, 30  # at most, for each start and for the best of them
SETTLED = 1e-6  # rad, and of ‖t‖ = 1: a step that is as good as none
SMALLEST_SCALE = 0.01  # px: no flow is better than that
SPIN = 0.001  # rad/frame: how objects turn relative to the background, as a deviation
CORRELATED = 50  # pixels that share an error: they lie within a patch of 7 × 7
Pose = tuple[np.ndarray, np.ndarray]  # R and t


@dataclass(frozen=True, kw_only=True)
class CameraMotion:
    """One rigid motion of the whole scene before the camera, P₁ = R P₀ + t.

    Attributes
    ----------
    rotation : (3, 3) float64
        R.
    translation : (3,) float64
        t, of length 1: its true length cannot be known.
    rotation_alone : (3, 3) float64
        The rotation that fits best without translation; `rotation` where that was known.
    residual : float
        Robust standard deviation of the distances from epipolar lines, px.
    parallax : float
        Median length of what rotation alone leaves of the flow, px: what depth is seen by.
    inliers : float
        Share of pixels within three such deviations.
    """

    rotation: np.ndarray
    translation: np.ndarray
    rotation_alone: np.ndarray
    residual: float
    parallax: float
    inliers: float


def camera_motion(
    flow: np.ndarray,
    confidence: np.ndarray,
    camera: Camera,
    *,
    rotation: np.ndarray | None = None,
    near: np.ndarray | None = None,
) -> CameraMotion:
    """Fit one rigid motion to a flow field in which other things may move as well.

    The robust distances from epipolar lines are minimised, weighted by confidence, over rotation
    and direction of translation, from several starts: essential matrices by random sampling
    (USAC), of whose two rotations the smaller is taken, because frames are close in time, and
    translation along each axis. The best is kept, in the direction that puts the scene before the
    camera.

    Parameters
    ----------
    flow : (H, W, 2) float32
        px/frame.
    confidence : (H, W) float32
        In [0, 1]; pixels of confidence 0 take no part.
    camera : Camera
        Without distortion: that of the result which the flow is from.
    rotation : (3, 3) array, optional
        R, where it is known: only the direction of translation is fitted then.
    near : (3, 3) array, optional
        A rotation that R is likely to be near to, for parts of an image that alone show too
        little to tell rotation from translation.

    Returns
    -------
    CameraMotion

    Raises
    ------
    ValueError
        If too few pixels are trusted, or the camera has distortion.

    References
    ----------
    Raguram et al., "USAC: a universal framework for random sample consensus", PAMI 2013,
    doi 10.1109/TPAMI.2012.257; Nistér, "An efficient solution to the five-point relative pose
    problem", PAMI 2004, doi 10.1109/TPAMI.2004.17.
    """
    check_pinhole(camera, "give the camera of the result, or camera.pinhole()")
    before, after, trust = _correspondences(flow, confidence, camera)
    focal = camera.focal
    few = slice(None, None, max(1, len(trust) // FEW))
    free = _Free(unknowns=6 if rotation is None else 3, near=near)
    if rotation is None:
        starts = _starts(before[few], after[few], trust[few], focal)
    else:
        starts = _turned_starts(before[few], after[few], trust[few], np.asarray(rotation, float))
    candidates = [
        _refine(before[few], after[few], trust[few], focal, start, free, iterations=STARTING)
        for start in starts
    ]
    scale = min(candidate[2] for candidate in candidates)
    best = min(
        candidates,
        key=lambda pose: _cost(before[few], after[few], trust[few], focal, pose, scale),
    )
    turn, translation, scale = _refine(
        before, after, trust, focal, best[:2], free, iterations=ITERATIONS
    )
    distance, _, inverse_depth = _epipolar(before, after, turn, translation, focal)
    if (trust * np.sign(inverse_depth)).sum() < 0:
        translation = -translation
    alone = _rotation_alone(before, after) if rotation is None else turn
    left = _beyond(before, after, alone)
    return CameraMotion(
        rotation=turn,
        translation=translation,
        rotation_alone=alone,
        residual=1.4826 * _weighted_median(np.abs(distance), trust),
        parallax=focal * float(np.median(np.linalg.norm(left, axis=1))),
        inliers=float((np.abs(distance) <= 3 * scale).mean()),
    )


def distance_from_rays(
    flow: np.ndarray,
    confidence: np.ndarray,
    camera: Camera,
    rotation: np.ndarray,
    translation: np.ndarray,
) -> float:
    """Return how far a flow is from where a known motion can take points.

    Where the nearest point of the epipolar line lies behind the camera, that is the distance from
    its end, the point at infinity.

    Parameters
    ----------
    flow : (H, W, 2) float32
        px/frame.
    confidence : (H, W) float32
        In [0, 1], the weight of a pixel.
    camera : Camera
    rotation, translation : (3, 3) and (3,)
        R and t ≠ 0, of any length.

    Returns
    -------
    float
        Robust standard deviation, px.

    Raises
    ------
    ValueError
        If too few pixels are trusted.
    """
    before, after, trust = _correspondences(flow, confidence, camera)
    direction = translation / np.linalg.norm(translation)
    distance, _, depth = _epipolar(before, after, rotation, direction, camera.focal)
    end = camera.focal * np.linalg.norm(_beyond(before, after, rotation), axis=1)
    return 1.4826 * _weighted_median(np.where(depth > 0, np.abs(distance), end), trust)


@dataclass(frozen=True, kw_only=True)
class _Free:
    """What of a motion is free: the first unknowns of (t, ω), and a rotation it lies near to."""

    unknowns: int
    near: np.ndarray | None


def spin_prior(rotation: np.ndarray, near: np.ndarray, noise: float) -> tuple[float, np.ndarray]:
    """Return stiffness and offset, rad, of the prior that draws a rotation to another.

    It is a normal distribution of `SPIN` rad, weighed against data whose errors of `noise` px are
    common to `CORRELATED` of the pixels.
    """
    offset = cv2.Rodrigues(near @ rotation.T)[0][:, 0]
    return CORRELATED * (noise / SPIN) ** 2, offset


def triangulate(
    before: np.ndarray, after: np.ndarray, rotation: np.ndarray, translation: np.ndarray
) -> np.ndarray:
    """Return the inverse depth, in units of 1/‖t‖, that takes a point nearest to its target.

    Parameters
    ----------
    before, after : (N, 3)
        Rays (x̂, ŷ, 1) in frames 0 and 1.
    rotation, translation : (3, 3) and (3,)

    Returns
    -------
    (N,) float64
        Signed; 0 where the point lies on the epipole.
    """
    turned = before @ rotation.T
    # With p = R x̂ + d t, x̂₁ p₃ = p₁ and ŷ₁ p₃ = p₂ are linear in d.
    offset = after[:, :2] * turned[:, 2:] - turned[:, :2]
    direction = translation[:2] - after[:, :2] * translation[2]
    square = (direction**2).sum(axis=1)
    return (offset * direction).sum(axis=1) / np.maximum(square, 1e-18)


def _correspondences(
    flow: np.ndarray, confidence: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rays (x̂, ŷ, 1) in both frames, (N, 3) each, of a regular sample, and their trust."""
    height, width = confidence.shape
    stride = max(1, round((np.count_nonzero(confidence) / SAMPLES) ** 0.5))
    rows, columns = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    rows, columns = rows.ravel(), columns.ravel()
    moved = flow[rows, columns].astype(np.float64)
    trust = confidence[rows, columns].astype(np.float64)
    taken = (trust > 0) & np.isfinite(moved).all(axis=1)
    if (trust[taken] > CONFIDENT).sum() < 8:
        raise ValueError(
            f"only {int((trust > CONFIDENT).sum())} of {trust.size} sampled pixels have a "
            f"confidence above {CONFIDENT}: the camera's motion needs at least 8"
        )
    cx, cy = camera.center_for(height, width)
    start = np.stack([columns - cx, rows - cy], axis=1)[taken]
    ones = np.ones((len(start), 1))
    before = np.hstack([start / camera.focal, ones])
    after = np.hstack([(start + moved[taken]) / camera.focal, ones])
    return before, after, trust[taken]


def _starts(before: np.ndarray, after: np.ndarray, trust: np.ndarray, focal: float) -> list[Pose]:
    """Return poses to start from: essential matrices by random sampling, and the three axes.

    Small motions leave room for wrong ones that meet most of the flow within the threshold.
    """
    starts: list[Pose] = [(np.eye(3), axis) for axis in np.eye(3)]
    chosen = trust > CONFIDENT
    parameters = cv2.UsacParams()
    parameters.confidence = 0.9999
    parameters.maxIterations = 2000
    parameters.sampler = cv2.SAMPLING_UNIFORM
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_INNER_LO
    parameters.loIterations, parameters.loSampleSize = 10, 50
    parameters.randomGeneratorState = 0  # the same every time
    identity, none = np.eye(3), np.zeros(5)
    for threshold in THRESHOLDS:
        parameters.threshold = threshold / focal
        essential, _ = cv2.findEssentialMat(
            before[chosen, :2], after[chosen, :2], identity, identity, none, none, parameters
        )
        if essential is None or essential.shape[0] < 3:  # no motion at all
            continue
        first, second, direction = cv2.decomposeEssentialMat(essential[:3])
        smaller = first if np.trace(first) > np.trace(second) else second
        starts.append((np.asarray(smaller, np.float64), np.asarray(direction[:, 0], np.float64)))
    return starts


def _turned_starts(
    before: np.ndarray, after: np.ndarray, trust: np.ndarray, rotation: np.ndarray
) -> list[Pose]:
    """Return translations to start from where the rotation is known: axes, and a linear fit."""
    normal = np.cross(before @ rotation.T, after) * trust[:, None]  # of the epipolar planes
    _, _, axes = np.linalg.svd(normal, full_matrices=False)
    return [(rotation, axis) for axis in (*np.eye(3), axes[-1])]


def _refine(
    before: np.ndarray,
    after: np.ndarray,
    trust: np.ndarray,
    focal: float,
    start: Pose,
    free: "_Free",
    *,
    iterations: int,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Minimise the robust distances from epipolar lines; return pose and scale of distances, px."""
    unknowns = free.unknowns
    rotation, translation = start
    scale = 0.0
    for _ in range(iterations):
        distance, slope, inverse_depth = _epipolar(before, after, rotation, translation, focal)
        if (trust * np.sign(inverse_depth)).sum() < 0:
            translation = -translation
            distance, slope, inverse_depth = _epipolar(before, after, rotation, translation, focal)
        scale = max(1.4826 * _weighted_median(np.abs(distance), trust), SMALLEST_SCALE)
        weight = trust / (1 + (distance / (2 * scale)) ** 2) ** 2
        weight *= np.where(inverse_depth > 0, 1.0, 0.2)  # behind the camera
        normal = (slope * weight[:, None]).T @ slope
        # Along t the scale changes, which nothing tells: hold it.
        along = np.concatenate([translation, np.zeros(3)])
        normal += (np.trace(normal) + 1e-30) * (np.outer(along, along) + 1e-9 * np.eye(6))
        pull = slope.T @ (weight * distance)
        if free.near is not None:
            stiffness, offset = spin_prior(rotation, free.near, scale)
            normal[3:, 3:] += stiffness * np.eye(3)
            pull[3:] += stiffness * offset
        step = np.zeros(6)
        step[:unknowns] = np.linalg.solve(normal[:unknowns, :unknowns], pull[:unknowns])
        turn = cv2.Rodrigues(step[3:])[0]
        rotation = turn @ rotation
        translation = turn @ translation + step[:3]
        translation = translation / np.linalg.norm(translation)
        if np.linalg.norm(step) < SETTLED:
            break
    return rotation, translation, scale


def _cost(
    before: np.ndarray,
    after: np.ndarray,
    trust: np.ndarray,
    focal: float,
    pose: tuple[np.ndarray, np.ndarray, float],
    scale: float,
) -> float:
    """Return the robust cost (Geman–McClure) of a pose at a common scale, px."""
    distance, _, inverse_depth = _epipolar(before, after, *pose[:2], focal)
    square = (distance / (2 * scale)) ** 2
    cost = np.where(inverse_depth > 0, square / (1 + square), 1.0)
    return float((trust * cost).sum())


def _epipolar(
    before: np.ndarray,
    after: np.ndarray,
    rotation: np.ndarray,
    translation: np.ndarray,
    focal: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return signed distances from epipolar lines, px, how they fall with the motion, and depth.

    Returns
    -------
    distance : (N,)
    slope : (N, 6)
        Of the place where the line is, along its normal, in translation and rotation: px.
    inverse_depth : (N,)
        Of the nearest point of the line.
    """
    inverse_depth = triangulate(before, after, rotation, translation)
    moved = before @ rotation.T + inverse_depth[:, None] * translation
    nearness = 1 / np.maximum(moved[:, 2], 0.05)
    x, y = moved[:, 0] * nearness, moved[:, 1] * nearness
    lever = inverse_depth * nearness
    zero = np.zeros_like(x)
    # Of a point P: δP = δT + δω × P, divided by its depth and projected.
    horizontal = np.stack([lever, zero, -lever * x, -x * y, 1 + x * x, -y], axis=1)
    vertical = np.stack([zero, lever, -lever * y, -1 - y * y, x * y, x], axis=1)
    line = np.stack([translation[0] - x * translation[2], translation[1] - y * translation[2]], 1)
    normal = np.stack([-line[:, 1], line[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-9)[:, None]
    distance = focal * (normal * (after[:, :2] - np.stack([x, y], axis=1))).sum(axis=1)
    slope = focal * (normal[:, :1] * horizontal + normal[:, 1:] * vertical)
    return distance, slope, inverse_depth


def _rotation_alone(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the rotation, (3, 3), that leaves least of the displacements."""
    rotation = np.eye(3)
    for _ in range(10):
        left = _beyond(before, after, rotation)
        x, y = (after[:, :2] - left).T
        horizontal = np.stack([-x * y, 1 + x * x, -y], axis=1)
        vertical = np.stack([-1 - y * y, x * y, x], axis=1)
        slope = np.concatenate([horizontal, vertical])
        length = np.linalg.norm(left, axis=1)
        weight = 1 / np.maximum(length, max(float(np.median(length)), 1e-12))  # Huber's
        weighted = slope * np.tile(weight, 2)[:, None]
        step = np.linalg.solve(weighted.T @ slope, weighted.T @ left.T.ravel())
        rotation = cv2.Rodrigues(step)[0] @ rotation
        if np.linalg.norm(step) < SETTLED:
            break
    return rotation


def _beyond(before: np.ndarray, after: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return what a rotation leaves of the displacements, (N, 2), normalised."""
    turned = before @ rotation.T
    return after[:, :2] - turned[:, :2] / turned[:, 2:]


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
