"""A pair of frames from a camera that reads row after row, as if it read all rows at once."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.camera import camera_estimate
from tisfm.motion.estimate import Estimate
from tisfm.motion.problems import pyramid_of
from tisfm.rigid import KnownPose, rigid_motion, rigid_twist
from tisfm.settings import Settings
from tisfm.shutter import UnrolledPixels, nodes_of

ROUNDS = 2  # of motion and frames, each from the other
STEPS = 4  # of the search for where a pixel of frame 1 was in frame 0
# Motions that frames are unrolled by; of others, nothing is known.
KNOWN = ("converged", "iteration_limit", "uncertain", "pure_rotation", "little_parallax")


@dataclass(frozen=True, kw_only=True)
class GlobalShutterPair:
    """Two frames whose rows were all read with the middle one.

    Attributes
    ----------
    grey0, grey1 : (H, W) float32
    frame : (H, W) or (H, W, 3) uint8
        Frame 0 as a picture.
    counted : tuple of two (H, W) bool, or None
        Pixels that count: those that are ignored, or that the frames do not show, do not.
    """

    grey0: np.ndarray
    grey1: np.ndarray
    frame: np.ndarray
    counted: tuple[np.ndarray, np.ndarray] | None


def global_shutter_pair(
    grey0: np.ndarray,
    grey1: np.ndarray,
    frame: np.ndarray,
    counted: tuple[np.ndarray, np.ndarray] | None,
    camera: Camera,
    settings: Settings,
    pose: KnownPose | None,
) -> GlobalShutterPair | None:
    """Return a pair as if all rows of each frame had been read with its middle one.

    The camera is taken to move evenly from before frame 0 until after frame 1. Its motion, and
    depth, are found from the frames as they are, and again from those that are made with them.

    Parameters
    ----------
    grey0, grey1, frame, counted
        As in `GlobalShutterPair`, but as they were read.
    camera : Camera
        A pinhole; its readout is a share of the time from frame 0 to frame 1.
    settings : Settings
    pose : KnownPose or None
        What is known of the motion from one middle row to the other.

    Returns
    -------
    GlobalShutterPair or None
        None where no motion is found.
    """
    found: GlobalShutterPair | None = None
    for _ in range(ROUNDS):
        first, second = (grey0, grey1) if found is None else (found.grey0, found.grey1)
        seen = counted if found is None else found.counted
        estimate = camera_estimate(
            pyramid_of(first, second, camera, settings, seen), settings, pose
        )
        maps = _maps(estimate, camera, pose)
        if maps is None:
            break
        kept = [~map_.valid for map_ in maps]
        if counted is not None:
            for ignored, map_, one in zip(kept, maps, counted, strict=True):
                ignored |= map_.nearest((~one).astype(np.float32)) > 0
        found = GlobalShutterPair(
            grey0=maps[0].apply(grey0),
            grey1=maps[1].apply(grey1),
            frame=maps[0].apply(frame),
            counted=(~kept[0], ~kept[1]) if any(part.any() for part in kept) else None,
        )
    return found


def _maps(
    estimate: Estimate, camera: Camera, pose: KnownPose | None
) -> tuple[UnrolledPixels, UnrolledPixels] | None:
    """Return what leads to both frames as they were read; None where no motion is known."""
    shape = estimate.inverse_depth.shape
    if estimate.status not in KNOWN or estimate.motions is None:
        return None
    rate = estimate.motions[0]
    if pose is not None and pose.translation is not None:
        rate = rigid_twist(pose.rotation, pose.translation)
    inverse_depth = _smooth(estimate.inverse_depth)
    if not (np.isfinite(rate).all() and np.isfinite(inverse_depth).all()):
        return None
    depths = [_at(inverse_depth, nodes_of(shape)), _in_next(inverse_depth, rate, camera)]
    first, second = (
        UnrolledPixels(camera, camera.readout or 0.0, rate, depth, shape) for depth in depths
    )
    return (first, second) if first.valid.any() and second.valid.any() else None


def _smooth(inverse_depth: np.ndarray) -> np.ndarray:
    """Return inverse depth as it is between nodes, (H, W) float32: edges would tear frames."""
    x = nodes_of(inverse_depth.shape)[0, :, 0]
    return cv2.GaussianBlur(inverse_depth, (0, 0), float(x[1] - x[0]))


def _in_next(inverse_depth: np.ndarray, rate: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the inverse depth of frame 1 at its nodes, (h, w), from that of frame 0, (H, W)."""
    rotation, translation = rigid_motion(rate)
    center = np.array(camera.center_for(*inverse_depth.shape))
    wanted = nodes_of(inverse_depth.shape)
    there = wanted
    for _ in range(STEPS):
        known = _at(inverse_depth, there)
        ray = np.concatenate([(there - center) / camera.focal, np.ones((*known.shape, 1))], axis=2)
        moved = ray @ rotation.T + known[..., None] * translation
        z = np.maximum(moved[..., 2], 1e-3)
        there = there + wanted - (moved[..., :2] / z[..., None] * camera.focal + center)
    return np.asarray(known / z)


def _at(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return an image, (H, W) float32, at places, (h, w, 2) px; beyond, it repeats."""
    x, y = np.moveaxis(places.astype(np.float32), -1, 0)
    found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float64)
