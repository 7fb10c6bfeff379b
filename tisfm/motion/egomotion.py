"""The camera's motion from a flow field: where ``motion="camera"`` starts."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera, check_pinhole
from tisfm.checks import unmasked
from tisfm.kernels.model.constants import NEAREST
from tisfm.visibility.confidence import median

SAMPLES = 5000  # pixels that take part: more hardly help, and all of them are neighbours
CONFIDENT = 0.1  # least confidence of those that the essential matrix is drawn from
THRESHOLDS = (0.05, 0.2, 0.8)  # px from the epipolar line, of inliers of essential matrices
FEW = 1000  # of the samples, by which the best of several starts is found
STARTING, ITERATIONS = 6, 30  # at most, for each start and for the best of them
SETTLED = 1e-6  # rad, and of ‖t‖ = 1: a step that is as good as none
SMALLEST_SCALE = 0.01  # px: no flow is better than that
SPIN = 0.001  # rad/frame: how objects turn relative to the background, as a deviation
CORRELATED = 50  # pixels that share an error: they lie within a patch of 7 × 7
FEWEST_SAMPLES = 8  # that are confident: essential matrices are drawn from 5, and more decide
MAD_TO_DEVIATION = 1.4826  # of a normal distribution: its deviation over its median distance
LEAST_STIFFNESS, LEAST_TRACE = 1e-9, 1e-30  # of normal equations, the former of their trace
# In place of what may be 0 and divides: lengths and squares of normalised vectors, and the typical
# displacement of flow that is a rotation.
LEAST_LENGTH, LEAST_SQUARE, LEAST_DISPLACEMENT = 1e-9, 1e-18, 1e-12
Pose = tuple[np.ndarray, np.ndarray]  # R and t


class TooFewPixelsError(ValueError):
    """Too few pixels of a flow field are trusted to fit a motion to them."""


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
    TooFewPixelsError
        A ValueError: if too few pixels are trusted.
    ValueError
        If the camera has distortion, or a value is masked.

    References
    ----------
    Raguram et al., "USAC: a universal framework for random sample consensus", PAMI 2013,
    doi 10.1109/TPAMI.2012.257; Nistér, "An efficient solution to the five-point relative pose
    problem", PAMI 2004, doi 10.1109/TPAMI.2004.17.
    """
    check_pinhole(camera, "give the camera of the result, or camera.pinhole()")
    flow = unmasked(flow, "flow")
    confidence = unmasked(
        confidence, "confidence", advice="fill them first, for instance by confidence.filled(0)"
    )
    rays = _correspondences(flow, confidence, camera)
    few = rays.every(max(1, rays.trust.size // FEW))
    if few.confident.sum() < FEWEST_SAMPLES:  # they lie in a small part of the image
        few = rays
    free = _Free(unknowns=6 if rotation is None else 3, near=near)
    starts = _starts(few) if rotation is None else _turned_starts(few, np.asarray(rotation, float))
    candidates = [_refine(few, start, free, iterations=STARTING) for start in starts]
    scale = min(candidate[2] for candidate in candidates)
    best = min(candidates, key=lambda pose: _cost(few, pose[:2], scale))
    turn, translation, scale = _refine(rays, best[:2], free, iterations=ITERATIONS)
    nearest = _nearest(rays, turn, translation)
    distance = np.abs(nearest.distance)
    if rays.trust @ np.sign(nearest.inverse_depth) < 0:
        translation = -translation
    alone = _rotation_alone(rays) if rotation is None else turn
    return CameraMotion(
        rotation=turn,
        translation=translation,
        rotation_alone=alone,
        residual=_robust_deviation(distance, rays.trust),
        parallax=camera.focal * float(np.median(_length(_beyond(rays, alone)))),
        inliers=float((distance <= 3 * scale).mean()),
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
    TooFewPixelsError
        A ValueError: if too few pixels are trusted.
    """
    rays = _correspondences(flow, confidence, camera)
    nearest = _nearest(rays, rotation, translation / np.linalg.norm(translation))
    end = camera.focal * _length(_beyond(rays, rotation))
    off = np.where(nearest.inverse_depth > 0, np.abs(nearest.distance), end)
    return _robust_deviation(off, rays.trust)


@dataclass(frozen=True, kw_only=True)
class _Rays:
    """Corresponding rays, a coordinate in each row.

    Attributes
    ----------
    before : (3, N) float64
        (x̂, ŷ, 1) in frame 0.
    after : (2, N) float64
        (x̂, ŷ) in frame 1.
    trust : (N,) float64
    focal : float
        px.
    """

    before: np.ndarray
    after: np.ndarray
    trust: np.ndarray
    focal: float

    @property
    def confident(self) -> np.ndarray:
        """Which of them essential matrices are drawn from, (N,) bool."""
        return self.trust > CONFIDENT

    def every(self, stride: int) -> "_Rays":
        """Return one of `stride` of them, at even distances."""
        before, after, trust = (
            np.ascontiguousarray(array[..., ::stride])
            for array in (self.before, self.after, self.trust)
        )
        return _Rays(before=before, after=after, trust=trust, focal=self.focal)


@dataclass(frozen=True, kw_only=True)
class _Nearest:
    """The points of epipolar lines that are nearest to rays of frame 1, (N,) each.

    Attributes
    ----------
    inverse_depth
        By which they are where they are.
    x, y, nearness
        Where that is, normalised, and 1 over the depth that they have there.
    normal_x, normal_y
        Its normal, of length 1.
    distance
        From the line, px, signed.
    """

    inverse_depth: np.ndarray
    x: np.ndarray
    y: np.ndarray
    nearness: np.ndarray
    normal_x: np.ndarray
    normal_y: np.ndarray
    distance: np.ndarray


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


def hold_scale(normal: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the normal equations of a step in (t, ω), made regular.

    Along t the scale changes, which nothing tells: it is held.

    Parameters
    ----------
    normal : (6, 6)
    direction : (3,)
        Of t, of length 1.
    """
    along = np.concatenate([direction, np.zeros(3)])
    held = np.outer(along, along) + LEAST_STIFFNESS * np.eye(6)
    return normal + (np.trace(normal) + LEAST_TRACE) * held


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
    return _inverse_depth((before @ rotation.T).T, after.T[:2], translation)


def _inverse_depth(turned: np.ndarray, after: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return the same of coordinates in rows, (3, N) of R x̂ and (2, N)."""
    # With p = R x̂ + d t, x̂₁ p₃ = p₁ and ŷ₁ p₃ = p₂ are linear in d.
    along_x = translation[0] - after[0] * translation[2]
    along_y = translation[1] - after[1] * translation[2]
    pulled = (after[0] * turned[2] - turned[0]) * along_x
    pulled += (after[1] * turned[2] - turned[1]) * along_y
    return pulled / np.maximum(along_x * along_x + along_y * along_y, LEAST_SQUARE)


def _correspondences(flow: np.ndarray, confidence: np.ndarray, camera: Camera) -> _Rays:
    """Return the rays of a regular sample of a flow."""
    height, width = confidence.shape
    stride = max(1, round((np.count_nonzero(confidence) / SAMPLES) ** 0.5))
    rows, columns = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    rows, columns = rows.ravel(), columns.ravel()
    moved = flow[rows, columns].astype(np.float64)
    trust = confidence[rows, columns].astype(np.float64)
    taken = (trust > 0) & np.isfinite(moved).all(axis=1)
    confident = int((trust[taken] > CONFIDENT).sum())
    if confident < FEWEST_SAMPLES:
        raise TooFewPixelsError(
            f"only {confident} of {trust.size} sampled pixels have a confidence above "
            f"{CONFIDENT}: the camera's motion needs at least {FEWEST_SAMPLES}"
        )
    cx, cy = camera.center_for(height, width)
    start = np.stack([columns - cx, rows - cy])[:, taken]
    return _Rays(
        before=np.vstack([start / camera.focal, np.ones(start.shape[1])]),
        after=(start + moved[taken].T) / camera.focal,
        trust=trust[taken],
        focal=camera.focal,
    )


def _starts(rays: _Rays) -> list[Pose]:
    """Return poses to start from: essential matrices by random sampling, and the three axes.

    Small motions leave room for wrong ones that meet most of the flow within the threshold.
    """
    starts: list[Pose] = [(np.eye(3), axis) for axis in np.eye(3)]
    chosen = rays.confident
    before, after = rays.before[:2, chosen].T.copy(), rays.after[:, chosen].T.copy()
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
        parameters.threshold = threshold / rays.focal
        try:
            essential, _ = cv2.findEssentialMat(
                before, after, identity, identity, none, none, parameters
            )
        except cv2.error:  # of samples that do not determine one: there is no start from there
            continue
        if essential is None or essential.shape[0] < 3 or not np.isfinite(essential).all():
            continue
        first, second, direction = cv2.decomposeEssentialMat(essential[:3])
        smaller = first if np.trace(first) > np.trace(second) else second
        starts.append((np.asarray(smaller, np.float64), np.asarray(direction[:, 0], np.float64)))
    return starts


def _turned_starts(rays: _Rays, rotation: np.ndarray) -> list[Pose]:
    """Return translations to start from where the rotation is known: axes, and a linear fit."""
    after = np.vstack([rays.after, np.ones(rays.trust.size)])
    normal = np.cross(rotation @ rays.before, after, axis=0) * rays.trust  # of epipolar planes
    axes, _, _ = np.linalg.svd(normal, full_matrices=False)
    return [(rotation, axis) for axis in (*np.eye(3), axes[:, -1])]


def _refine(
    rays: _Rays, start: Pose, free: _Free, *, iterations: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Minimise the robust distances from epipolar lines; return pose and scale of distances, px."""
    unknowns = free.unknowns
    rotation, translation = start
    scale = 0.0
    for _ in range(iterations):
        nearest = _nearest(rays, rotation, translation)
        if rays.trust @ np.sign(nearest.inverse_depth) < 0:
            translation = -translation
            nearest = _nearest(rays, rotation, translation)
        distance, slope = nearest.distance, _slope(nearest, rays.focal)
        scale = max(_robust_deviation(np.abs(distance), rays.trust), SMALLEST_SCALE)
        weight = rays.trust / (1 + (distance / (2 * scale)) ** 2) ** 2
        weight *= np.where(nearest.inverse_depth > 0, 1.0, 0.2)  # behind the camera
        normal = (slope * weight) @ slope.T
        normal = hold_scale(normal, translation)
        pull = slope @ (weight * distance)
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


def _cost(rays: _Rays, pose: Pose, scale: float) -> float:
    """Return the robust cost (Geman–McClure) of a pose at a common scale, px."""
    nearest = _nearest(rays, *pose)
    square = (nearest.distance / (2 * scale)) ** 2
    return float(rays.trust @ np.where(nearest.inverse_depth > 0, square / (1 + square), 1.0))


def _nearest(rays: _Rays, rotation: np.ndarray, translation: np.ndarray) -> _Nearest:
    """Return the points of the epipolar lines of a pose."""
    turned = rotation @ rays.before
    inverse_depth = _inverse_depth(turned, rays.after, translation)
    nearness = 1 / np.maximum(turned[2] + inverse_depth * translation[2], NEAREST)
    x = (turned[0] + inverse_depth * translation[0]) * nearness
    y = (turned[1] + inverse_depth * translation[1]) * nearness
    normal_x, normal_y = y * translation[2] - translation[1], translation[0] - x * translation[2]
    inverse = 1 / np.maximum(np.sqrt(normal_x * normal_x + normal_y * normal_y), LEAST_LENGTH)
    normal_x *= inverse
    normal_y *= inverse
    return _Nearest(
        inverse_depth=inverse_depth,
        x=x,
        y=y,
        nearness=nearness,
        normal_x=normal_x,
        normal_y=normal_y,
        distance=rays.focal * (normal_x * (rays.after[0] - x) + normal_y * (rays.after[1] - y)),
    )


def _slope(nearest: _Nearest, focal: float) -> np.ndarray:
    """Return how the distances fall with translation and rotation, (6, N), px."""
    x, y = nearest.x, nearest.y
    a, b = focal * nearest.normal_x, focal * nearest.normal_y
    across = a * x + b * y
    lever = nearest.inverse_depth * nearest.nearness
    slope = np.empty((6, x.size))
    # Of a point P: δP = δT + δω × P, divided by its depth and projected.
    np.multiply(lever, a, out=slope[0])
    np.multiply(lever, b, out=slope[1])
    np.multiply(-lever, across, out=slope[2])
    np.multiply(-y, across, out=slope[3])
    slope[3] -= b
    np.multiply(x, across, out=slope[4])
    slope[4] += a
    np.subtract(b * x, a * y, out=slope[5])
    return slope


def _rotation_alone(rays: _Rays) -> np.ndarray:
    """Return the rotation, (3, 3), that leaves least of the displacements."""
    rotation = np.eye(3)
    for _ in range(10):
        left = _beyond(rays, rotation)
        x, y = rays.after - left
        length = _length(left)
        weight = 1 / np.maximum(length, max(median(length), LEAST_DISPLACEMENT))  # Huber's
        horizontal = np.stack([-x * y, 1 + x * x, -y])
        vertical = np.stack([-1 - y * y, x * y, x])
        normal = (horizontal * weight) @ horizontal.T + (vertical * weight) @ vertical.T
        pull = horizontal @ (weight * left[0]) + vertical @ (weight * left[1])
        try:
            step = np.linalg.solve(normal, pull)
        except np.linalg.LinAlgError:  # of rays that are all but parallel
            break
        rotation = cv2.Rodrigues(step)[0] @ rotation
        if np.linalg.norm(step) < SETTLED:
            break
    return rotation


def _beyond(rays: _Rays, rotation: np.ndarray) -> np.ndarray:
    """Return what a rotation leaves of the displacements, (2, N), normalised."""
    turned = rotation @ rays.before
    return rays.after - turned[:2] / turned[2]


def _length(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors, (2, N)."""
    return np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1])


def _robust_deviation(distances: np.ndarray, weights: np.ndarray) -> float:
    """Return the standard deviation that normally distributed distances (N,), unsigned, have."""
    return MAD_TO_DEVIATION * _weighted_median(distances, weights)


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
