"""Pixels that show the same picture in all frames although the camera turns.

A bonnet, a logo, a subtitle, a letterbox and the pattern noise of a sensor are fixed on the sensor.
Far points stay at rest as well if the camera only translates. So frames are compared only if points
at infinity have to move.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.checks.pair_evidence import rotation_angle
from tisfm.reconstruction.checks.settings import CHECKS
from tisfm.reconstruction.frames.image_motion import flow_scale, shrink_for_flow
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.result.path_check import LIMITS

DEVIATION_OF_MEDIAN = 1.4826  # standard deviation of a normal distribution over its median distance


def infinity_motion(rotations: Sequence[np.ndarray], camera: Camera) -> float:
    """Return the largest motion of points at infinity from the first frame, px of the frames."""
    return max(
        camera.focal * np.radians(rotation_angle(rotations[0].T @ other)) for other in rotations
    )


def camera_turns(pieces: Sequence[Piece], camera: Camera) -> bool:
    """Return whether points at infinity move enough in the largest piece of a path."""
    if not pieces:
        return False
    poses = max((piece.poses for piece in pieces), key=len)
    rotations = [pose[:3, :3] for pose in poses.values()]
    return infinity_motion(rotations, camera) > LIMITS.min_infinity_motion


def find_fixed_pixels(frames: PreparedFrames) -> np.ndarray | None:
    """Return the pixels that are fixed on the sensor, (H, W) bool; None if there are hardly any.

    Far points may be among them if the camera did not turn. If nearly all pixels are fixed, the
    camera did not move, and the result is None.
    """
    chosen = np.unique(np.linspace(0, frames.count - 1, CHECKS.max_fixed_frames).astype(int))
    if len(chosen) < CHECKS.min_fixed_frames:
        return None
    mask, fixed, moving = fixed_pixels([frames.grey(int(number)) for number in chosen])
    is_overlay = (
        fixed > LIMITS.max_fixed_share * (fixed + moving) and moving > CHECKS.min_moving_share
    )
    return mask if is_overlay else None


def fixed_pixels(
    frames: Sequence[np.ndarray],  # (H, W) uint8 or float32 grey levels, of frames far apart
) -> tuple[np.ndarray, float, float]:
    """Return the pixels that are fixed on the sensor, and shares of the frame.

    Returns (H, W) bool, with a margin of half a window around the fixed texture; and the shares of
    pixels with fixed texture and with moving texture.
    """
    small = [shrink_for_flow(np.asarray(frame, np.float32)) for frame in frames]
    stack = np.stack(small)
    middle = np.median(stack, axis=0)
    window = (CHECKS.fixed_window,) * 2
    deviation = cv2.boxFilter(np.median(np.abs(stack - middle), axis=0), -1, window)
    texture_of_median = cv2.boxFilter(gradient_length(middle), -1, window)
    texture = np.median(
        [cv2.boxFilter(gradient_length(frame), -1, window) for frame in small], axis=0
    )
    is_textured = texture > CHECKS.min_fixed_gradient
    # the median over frames blurs texture that moves
    shift = DEVIATION_OF_MEDIAN * deviation / np.maximum(texture_of_median, 1e-3)
    is_fixed = (
        is_textured
        & (shift < CHECKS.max_fixed_shift)
        & (texture_of_median > CHECKS.min_fixed_texture * texture)
    )
    margin = np.ones((CHECKS.fixed_window,) * 2, np.uint8)
    mask = cv2.dilate(is_fixed.astype(np.uint8), margin)
    height, width = frames[0].shape
    scale = flow_scale(small[0], frames[0])
    full = cv2.resize(mask, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_NEAREST)[
        :height, :width
    ]
    fixed = float(is_fixed.mean())
    return full > 0, fixed, float(is_textured.mean()) - fixed


def gradient_length(grey: np.ndarray) -> np.ndarray:
    """Return the length of the gradient, (H, W) float32, grey levels per px."""
    gradients = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    return cv2.magnitude(*gradients)
