"""The camera's motion from a flow field: the start of ``motion="camera"``."""

from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera, check_pinhole
from tisfm.checks import check_unmasked
from tisfm.errors import InputError
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
    triangulate_rays,
)
from tisfm.motion.settings import EGOMOTION


class TooFewPixelsError(InputError):
    """A flow field has too few trusted pixels to fit a motion."""


@dataclass(frozen=True, kw_only=True)
class CameraMotion:
    """One rigid motion of the whole scene in front of the camera, P₁ = R P₀ + t.

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
    likely_rotation: np.ndarray | None = None,
) -> CameraMotion:
    """Fit one rigid motion to a flow field, which may contain moving objects as well.

    The robust distances from epipolar lines, weighted by confidence, are minimised over rotation
    and direction of translation. The starts are essential matrices by random sampling (USAC) and
    translations along each axis. The smaller of the two rotations of an essential matrix is taken,
    because frames are close in time. The result has the least cost, and the sign of t that puts
    the scene in front of the camera.

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
    likely_rotation : (3, 3) array, optional
        A rotation that is probably close to R, for parts of an image that are too small to tell
        rotation from translation.

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
    flow = check_unmasked(flow, "flow")
    confidence = check_unmasked(
        confidence, "confidence", advice="fill them first, for instance by confidence.filled(0)"
    )
    rays = sample_rays(flow, confidence, camera)
    unknowns = FreeUnknowns(count=6 if rotation is None else 3, likely_rotation=likely_rotation)
    return _fit_motion(rays, _best_start(rays, rotation, unknowns), unknowns)


def refine_motion(
    flow: np.ndarray, confidence: np.ndarray, camera: Camera, start: Pose
) -> CameraMotion:
    """Fit a motion as `camera_motion` does, from a single start with ‖t‖ = 1."""
    return _fit_motion(
        sample_rays(flow, confidence, camera), start, FreeUnknowns(count=6, likely_rotation=None)
    )


def _fit_motion(rays: Rays, start: Pose, unknowns: FreeUnknowns) -> CameraMotion:
    """Return the motion of a robust fit to rays."""
    rotation, translation, scale = refine_pose(
        rays, start, unknowns, iterations=EGOMOTION.iterations
    )
    points = nearest_points(rays, rotation, translation)
    distances = np.abs(points.distance)
    if rays.trust @ np.sign(points.inverse_depth) < 0:
        translation = -translation
    pure_rotation = rotation_alone(rays) if unknowns.count == 6 else rotation
    return CameraMotion(
        rotation=rotation,
        translation=translation,
        rotation_alone=pure_rotation,
        residual=robust_deviation(distances, rays.trust),
        parallax=rays.focal * float(np.median(length(rotation_residual(rays, pure_rotation)))),
        inliers=float((distances <= 3 * scale).mean()),
    )


def deviation_from_pose(
    flow: np.ndarray,  # (H, W, 2) float32: px/frame
    confidence: np.ndarray,  # (H, W) float32: weight of each pixel, in [0, 1]
    camera: Camera,
    # rotation, translation: (3, 3) and (3,): R and t ≠ 0, of any length
    rotation: np.ndarray,
    translation: np.ndarray,
) -> float:  # robust standard deviation, px
    """Return the distance of a flow from the epipolar lines of a known motion.

    If the nearest point of a line lies behind the camera, the distance from the end of the line,
    the point at infinity, is used.

    Raises TooFewPixelsError, a ValueError, if too few pixels are trusted.
    """
    rays = sample_rays(flow, confidence, camera)
    points = nearest_points(rays, rotation, translation / np.linalg.norm(translation))
    infinity_distance = camera.focal * length(rotation_residual(rays, rotation))
    distances = np.where(points.inverse_depth > 0, np.abs(points.distance), infinity_distance)
    return robust_deviation(distances, rays.trust)


def triangulate(
    # rays0, rays1: (N, 3): rays (x̂, ŷ, 1) in frames 0 and 1
    rays0: np.ndarray,
    rays1: np.ndarray,
    # rotation, translation: (3, 3) and (3,)
    rotation: np.ndarray,
    translation: np.ndarray,
) -> np.ndarray:  # (N,) float64: signed; 0 where the point lies on the epipole
    """Return the inverse depth, in units of 1/‖t‖, that moves a point nearest to its match."""
    return triangulate_rays((rays0 @ rotation.T).T, rays1.T[:2], translation)


def sample_rays(flow: np.ndarray, confidence: np.ndarray, camera: Camera) -> Rays:
    """Return the rays of regularly spaced pixels of a flow."""
    height, width = confidence.shape
    stride = max(1, round((np.count_nonzero(confidence) / EGOMOTION.samples) ** 0.5))
    rows, columns = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    rows, columns = rows.ravel(), columns.ravel()
    displacements = flow[rows, columns].astype(np.float64)
    trust = confidence[rows, columns].astype(np.float64)
    is_used = (trust > 0) & np.isfinite(displacements).all(axis=1)
    confident_count = int((trust[is_used] > EGOMOTION.min_confidence).sum())
    if confident_count < EGOMOTION.min_confident_samples:
        raise TooFewPixelsError(
            f"only {confident_count} of {trust.size} sampled pixels have a confidence above "
            f"{EGOMOTION.min_confidence}: the camera's motion needs at least "
            f"{EGOMOTION.min_confident_samples}"
        )
    cx, cy = camera.center_for(height, width)
    positions = np.stack([columns - cx, rows - cy])[:, is_used]
    return Rays(
        rays0=np.vstack([positions / camera.focal, np.ones(positions.shape[1])]),
        rays1=(positions + displacements[is_used].T) / camera.focal,
        trust=trust[is_used],
        focal=camera.focal,
    )


def _best_start(rays: Rays, rotation: np.ndarray | None, unknowns: FreeUnknowns) -> Pose:
    """Return the motion of least cost after several starts were refined on a part of the rays.

    If `rotation` is given, all starts have this rotation.
    """
    sample = rays.subsample(max(1, rays.trust.size // EGOMOTION.start_samples))
    if (
        sample.is_confident.sum() < EGOMOTION.min_confident_samples
    ):  # the sample misses the confident rays
        sample = rays
    starts = (
        _initial_poses(sample)
        if rotation is None
        else _initial_translations(sample, np.asarray(rotation, float))
    )
    candidates = [
        refine_pose(sample, start, unknowns, iterations=EGOMOTION.start_iterations)
        for start in starts
    ]
    scale = min(candidate[2] for candidate in candidates)
    return min(candidates, key=lambda pose: pose_cost(sample, pose[:2], scale))[:2]


def _initial_poses(rays: Rays) -> list[Pose]:
    """Return initial poses: essential matrices by random sampling, and the three axes.

    For small motions, an essential matrix may be wrong and still fit most of the flow.
    """
    axes: list[Pose] = [(np.eye(3), axis) for axis in np.eye(3)]
    return axes + essential_poses(
        rays.select(rays.is_confident), EGOMOTION.inlier_distances, draws=EGOMOTION.max_draws
    )


def _initial_translations(rays: Rays, rotation: np.ndarray) -> list[Pose]:
    """Return initial poses for a known rotation: translations along axes, and a linear fit."""
    rays1 = np.vstack([rays.rays1, np.ones(rays.trust.size)])
    normals = np.cross(rotation @ rays.rays0, rays1, axis=0) * rays.trust
    axes, _, _ = np.linalg.svd(normals, full_matrices=False)
    return [(rotation, axis) for axis in (*np.eye(3), axes[:, -1])]
