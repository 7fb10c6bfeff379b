"""A pair of frames from a rolling shutter, resampled as if from a global shutter."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.camera import camera_estimate
from tisfm.motion.estimate import Estimate
from tisfm.motion.problems import pyramid_of
from tisfm.motion.settings import EGOMOTION
from tisfm.rigid import KnownPose, rigid_motion, rigid_twist
from tisfm.settings import Settings
from tisfm.shutter import GlobalShutterMap, interpolation_nodes

# Statuses of an estimate whose motion is good enough to correct the frames. The skew of a rolling
# shutter looks like a zoom or a lens, so it can contradict the camera until it is corrected.
MOTION_STATUSES = (
    "converged", "iteration_limit", "uncertain", "contradicted", "pure_rotation", "little_parallax",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class GlobalShutterPair:
    """Two frames as if all rows of each had been read at the time of the middle row."""

    # grey0, grey1: (H, W) float32
    grey0: np.ndarray
    grey1: np.ndarray
    frame: np.ndarray  # (H, W) or (H, W, 3) uint8: frame 0 as a picture
    # tuple of two (H, W) bool: pixels that are visible and not ignored; None: all
    valid: tuple[np.ndarray, np.ndarray] | None


def global_shutter_pair(
    # grey0, grey1, frame, valid: as in `GlobalShutterPair`, but before the correction
    grey0: np.ndarray,
    grey1: np.ndarray,
    frame: np.ndarray,
    valid: tuple[np.ndarray, np.ndarray] | None,
    camera: Camera,  # a pinhole; its readout is a share of the time from frame 0 to frame 1
    settings: Settings,
    pose: KnownPose | None,  # the known motion from one middle row to the other
) -> GlobalShutterPair | None:  # None if no motion could be estimated
    """Return a pair as if all rows of each frame had been read at the time of its middle row.

    The camera is assumed to move evenly from before frame 0 until after frame 1. Motion and depth
    are estimated from the given frames, and again from the frames that were corrected with the
    first estimate.
    """
    pair: GlobalShutterPair | None = None
    for _ in range(EGOMOTION.shutter_rounds):
        frame0, frame1 = (grey0, grey1) if pair is None else (pair.grey0, pair.grey1)
        current_valid = valid if pair is None else pair.valid
        estimate = camera_estimate(
            pyramid_of(frame0, frame1, camera, settings, current_valid), settings, pose
        )
        maps = _global_shutter_maps(estimate, camera, pose)
        if maps is None:
            break
        ignored = [~map_.valid for map_ in maps]
        if valid is not None:
            for mask, map_, pixels in zip(ignored, maps, valid, strict=True):
                mask |= map_.apply_nearest((~pixels).astype(np.float32)) > 0
        pair = GlobalShutterPair(
            grey0=maps[0].apply(grey0),
            grey1=maps[1].apply(grey1),
            frame=maps[0].apply(frame),
            valid=(~ignored[0], ~ignored[1]) if any(part.any() for part in ignored) else None,
        )
    return pair


def _global_shutter_maps(
    estimate: Estimate, camera: Camera, pose: KnownPose | None
) -> tuple[GlobalShutterMap, GlobalShutterMap] | None:
    """Return the maps from global-shutter frames to both given frames; None without a motion."""
    shape = estimate.inverse_depth.shape
    if estimate.status not in MOTION_STATUSES or estimate.motions is None:
        return None
    twist = estimate.motions[0]
    if pose is not None and pose.translation is not None:
        twist = rigid_twist(pose.rotation, pose.translation)
    inverse_depth = _smooth_depth(estimate.inverse_depth)
    if not (np.isfinite(twist).all() and np.isfinite(inverse_depth).all()):
        return None
    depths = [
        _sample(inverse_depth, interpolation_nodes(shape)),
        _depth_of_frame1(inverse_depth, twist, camera),
    ]
    map0, map1 = (
        GlobalShutterMap(camera, camera.readout or 0.0, twist, depth, shape) for depth in depths
    )
    return (map0, map1) if map0.valid.any() and map1.valid.any() else None


def _smooth_depth(inverse_depth: np.ndarray) -> np.ndarray:
    """Return inverse depth, (H, W), after a Gaussian filter: steps of depth would tear the frames.

    The standard deviation is the spacing of the grid on which the correction is computed.
    """
    x = interpolation_nodes(inverse_depth.shape)[0, :, 0]
    return cv2.GaussianBlur(inverse_depth, (0, 0), float(x[1] - x[0]))


def _depth_of_frame1(inverse_depth: np.ndarray, twist: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the inverse depth of frame 1 on the grid, (h, w), from that of frame 0, (H, W)."""
    rotation, translation = rigid_motion(twist)
    center = np.array(camera.center_for(*inverse_depth.shape))
    nodes = interpolation_nodes(inverse_depth.shape)
    positions = nodes
    for _ in range(EGOMOTION.shutter_iterations):
        depth = _sample(inverse_depth, positions)
        ray = np.concatenate(
            [(positions - center) / camera.focal, np.ones((*depth.shape, 1))], axis=2
        )
        points = ray @ rotation.T + depth[..., None] * translation
        z = np.maximum(points[..., 2], 1e-3)
        positions = positions + nodes - (points[..., :2] / z[..., None] * camera.focal + center)
    return np.asarray(depth / z)


def _sample(image: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return an image, (H, W) float32, at positions, (h, w, 2) px; its border pixels repeat."""
    x, y = np.moveaxis(positions.astype(np.float32), -1, 0)
    samples = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(samples, np.float64)
