"""The camera's motion from a flow field: the start of ``motion="camera"``."""

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

SAMPLES = 5000  # pixels that are fitted, about: neighbours are alike, so more hardly help
THRESHOLDS = (0.05, 0.2, 0.8)  # px: inliers of essential matrices, from the epipolar line
DRAWS = 2000  # most random samples of five correspondences
FEW = 1000  # samples that the best of several starts is chosen by
STARTING, ITERATIONS = 6, 30  # most iterations for each start, and for the best start
FEWEST_SAMPLES = 8  # confident samples: five give an essential matrix, and the others verify it


class TooFewPixelsError(InputError):
    """A flow field has too few trusted pixels to fit a motion."""


@dataclass(frozen=True, kw_only=True)
class CameraMotion:
    """One rigid motion of the whole scene before the camera, P₁ = R P₀ + t.

    Attributes
    ----------
    rotation : (3, 3) float64
        R.
    translation : (3,) float64
        t, of length 1, because its true length cannot be known.
    rotation_alone : (3, 3) float64
        The rotation that fits best without translation; `rotation` if that was given.
    residual : float
        Robust standard deviation of the distances from epipolar lines, px.
    parallax : float
        Median length of the flow that `rotation_alone` leaves, px: it shows depth.
    inliers : float
        Share of pixels within three robust deviations of their epipolar line.

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
    """Fit one rigid motion to a flow field, which may contain moving objects as well.

    The robust distances from epipolar lines, weighted by confidence, are minimised over rotation
    and direction of translation. The starts are essential matrices by random sampling (USAC) and
    translations along each axis. The smaller of the two rotations of an essential matrix is taken,
    because frames are close in time. The best result is kept, with the sign of t that puts the
    scene before the camera.

    Parameters
    ----------
    flow : (H, W, 2) float32
        px/frame.
    confidence : (H, W) float32
        In [0, 1]; pixels of confidence 0 are left out.
    camera : Camera
        Without distortion: the camera of the result that has the flow.
    rotation : (3, 3) array, optional
        R, if known: then only the direction of translation is fitted.
    near : (3, 3) array, optional
        A rotation that is likely near R, for parts of an image that are too small to tell rotation
        from translation.

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
    """Fit a motion as `camera_motion` does, from a single start with ‖t‖ = 1."""
    return _fitted(correspondences(flow, confidence, camera), start, Free(unknowns=6, near=None))


def _fitted(rays: Rays, start: Pose, free: Free) -> CameraMotion:
    """Return the motion of a robust fit to rays."""
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
    flow: np.ndarray,  # (H, W, 2) float32: px/frame
    confidence: np.ndarray,  # (H, W) float32: weight of each pixel, in [0, 1]
    camera: Camera,
    # rotation, translation: (3, 3) and (3,): R and t ≠ 0, of any length
    rotation: np.ndarray,
    translation: np.ndarray,
) -> float:  # robust standard deviation, px
    """Return the distance of a flow from the points that a known motion allows.

    If the nearest point of the epipolar line lies behind the camera, the distance from the line's
    end, the point at infinity, counts.

    Raises TooFewPixelsError: a ValueError: if too few pixels are trusted.
    """
    rays = correspondences(flow, confidence, camera)
    nearest = nearest_points(rays, rotation, translation / np.linalg.norm(translation))
    end = camera.focal * length(beyond(rays, rotation))
    off = np.where(nearest.inverse_depth > 0, np.abs(nearest.distance), end)
    return robust_deviation(off, rays.trust)


def triangulate(
    # before, after: (N, 3): rays (x̂, ŷ, 1) in frames 0 and 1
    before: np.ndarray,
    after: np.ndarray,
    # rotation, translation: (3, 3) and (3,)
    rotation: np.ndarray,
    translation: np.ndarray,
) -> np.ndarray:  # (N,) float64: signed; 0 where the point lies on the epipole
    """Return the inverse depth, in units of 1/‖t‖, that moves a point nearest to its match."""
    return inverse_depth_of((before @ rotation.T).T, after.T[:2], translation)


def correspondences(flow: np.ndarray, confidence: np.ndarray, camera: Camera) -> Rays:
    """Return the rays of regularly spaced pixels of a flow."""
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
    """Return the motion of least cost after refining several starts on a part of the rays.

    If `rotation` is given, all starts have this rotation.
    """
    few = rays.every(max(1, rays.trust.size // FEW))
    if few.confident.sum() < FEWEST_SAMPLES:  # the confident rays lie in a small part of the image
        few = rays
    starts = _starts(few) if rotation is None else _turned_starts(few, np.asarray(rotation, float))
    candidates = [refine(few, start, free, iterations=STARTING) for start in starts]
    scale = min(candidate[2] for candidate in candidates)
    return min(candidates, key=lambda pose: cost(few, pose[:2], scale))[:2]


def _starts(rays: Rays) -> list[Pose]:
    """Return initial poses: essential matrices by random sampling, and the three axes.

    For small motions, an essential matrix may be wrong and still fit most of the flow.
    """
    axes: list[Pose] = [(np.eye(3), axis) for axis in np.eye(3)]
    return axes + essential_poses(rays.where(rays.confident), THRESHOLDS, draws=DRAWS)


def _turned_starts(rays: Rays, rotation: np.ndarray) -> list[Pose]:
    """Return initial poses for a known rotation: translations along axes, and a linear fit."""
    after = np.vstack([rays.after, np.ones(rays.trust.size)])
    # Normals of epipolar planes.
    normal = np.cross(rotation @ rays.before, after, axis=0) * rays.trust
    axes, _, _ = np.linalg.svd(normal, full_matrices=False)
    return [(rotation, axis) for axis in (*np.eye(3), axes[:, -1])]
