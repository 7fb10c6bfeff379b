"""The camera's motion from a flow field: where ``motion="camera"`` starts."""

from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera, check_pinhole
from tisfm.checks import unmasked
from tisfm.errors import InputError
from tisfm.motion.epipolar_fit import (
    CONFIDENT,
    Free,
    Pose,
    Rays,
    beyond,
    cost,
    essential_poses,
    inverse_depth_of,
    length,
    nearest_points,
    refine,
    robust_deviation,
    rotation_alone,
)

SAMPLES = 5000  # pixels that take part: more hardly help, and all of them are neighbours
THRESHOLDS = (0.05, 0.2, 0.8)  # px from the epipolar line, of inliers of essential matrices
DRAWS = 2000  # of five correspondences each, at most
FEW = 1000  # of the samples, by which the best of several starts is found
STARTING, ITERATIONS = 6, 30  # at most, for each start and for the best of them
FEWEST_SAMPLES = 8  # that are confident: essential matrices are drawn from 5, and more decide


class TooFewPixelsError(InputError):
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

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.egomotion import camera_motion
    >>> from tisfm.scenes import static_scene
    >>> scene = static_scene("forward", 96, 128)
    >>> trust = np.ones(scene.depth.shape, np.float32)
    >>> motion = camera_motion(scene.flow.astype(np.float32), trust, scene.camera)
    >>> motion.rotation.shape, motion.translation.shape
    ((3, 3), (3,))
    >>> motion.parallax > 0.1  # px: there is depth to see
    True
    >>> motion.residual < 0.1  # px: one motion explains it
    True
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

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.egomotion import camera_motion
    >>> from tisfm.scenes import static_scene
    >>> scene = static_scene("sideways", 96, 128)
    >>> trust = np.ones(scene.depth.shape, np.float32)
    >>> motion = camera_motion(scene.flow.astype(np.float32), trust, scene.camera)
    >>> [round(abs(number), 1) for number in motion.translation.tolist()]  # ‖t‖ = 1, to the left
    [1.0, 0.0, 0.0]
    """
    check_pinhole(camera, "give the camera of the result, or camera.pinhole()")
    flow = unmasked(flow, "flow")
    confidence = unmasked(
        confidence, "confidence", advice="fill them first, for instance by confidence.filled(0)"
    )
    rays = correspondences(flow, confidence, camera)
    free = Free(unknowns=6 if rotation is None else 3, near=near)
    return _fitted(rays, _best_start(rays, rotation, free), free)


def refined_motion(
    flow: np.ndarray, confidence: np.ndarray, camera: Camera, start: Pose
) -> CameraMotion:
    """Do what `camera_motion` does, from one start, ‖t‖ = 1, that is near to the motion sought."""
    return _fitted(correspondences(flow, confidence, camera), start, Free(unknowns=6, near=None))


def _fitted(rays: Rays, start: Pose, free: Free) -> CameraMotion:
    """Return the motion that a robust fit to rays comes to."""
    turn, translation, scale = refine(rays, start, free, iterations=ITERATIONS)
    nearest = nearest_points(rays, turn, translation)
    distance = np.abs(nearest.distance)
    if rays.trust @ np.sign(nearest.inverse_depth) < 0:
        translation = -translation
    alone = rotation_alone(rays) if free.unknowns == 6 else turn
    return CameraMotion(
        rotation=turn,
        translation=translation,
        rotation_alone=alone,
        residual=robust_deviation(distance, rays.trust),
        parallax=rays.focal * float(np.median(length(beyond(rays, alone)))),
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
    rays = correspondences(flow, confidence, camera)
    nearest = nearest_points(rays, rotation, translation / np.linalg.norm(translation))
    end = camera.focal * length(beyond(rays, rotation))
    off = np.where(nearest.inverse_depth > 0, np.abs(nearest.distance), end)
    return robust_deviation(off, rays.trust)


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
    return inverse_depth_of((before @ rotation.T).T, after.T[:2], translation)


def correspondences(flow: np.ndarray, confidence: np.ndarray, camera: Camera) -> Rays:
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
    return Rays(
        before=np.vstack([start / camera.focal, np.ones(start.shape[1])]),
        after=(start + moved[taken].T) / camera.focal,
        trust=trust[taken],
        focal=camera.focal,
    )


def _best_start(rays: Rays, rotation: np.ndarray | None, free: Free) -> Pose:
    """Return the motion of several starts, each refined a little, that costs a part of them least.

    The rotation of all is `rotation` if that is known.
    """
    few = rays.every(max(1, rays.trust.size // FEW))
    if few.confident.sum() < FEWEST_SAMPLES:  # they lie in a small part of the image
        few = rays
    starts = _starts(few) if rotation is None else _turned_starts(few, np.asarray(rotation, float))
    candidates = [refine(few, start, free, iterations=STARTING) for start in starts]
    scale = min(candidate[2] for candidate in candidates)
    return min(candidates, key=lambda pose: cost(few, pose[:2], scale))[:2]


def _starts(rays: Rays) -> list[Pose]:
    """Return poses to start from: essential matrices by random sampling, and the three axes.

    Small motions leave room for wrong ones that meet most of the flow within the threshold.
    """
    axes: list[Pose] = [(np.eye(3), axis) for axis in np.eye(3)]
    return axes + essential_poses(rays.where(rays.confident), THRESHOLDS, draws=DRAWS)


def _turned_starts(rays: Rays, rotation: np.ndarray) -> list[Pose]:
    """Return translations to start from where the rotation is known: axes, and a linear fit."""
    after = np.vstack([rays.after, np.ones(rays.trust.size)])
    normal = np.cross(rotation @ rays.before, after, axis=0) * rays.trust  # of epipolar planes
    axes, _, _ = np.linalg.svd(normal, full_matrices=False)
    return [(rotation, axis) for axis in (*np.eye(3), axes[:, -1])]
