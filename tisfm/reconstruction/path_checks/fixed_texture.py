"""Pixels that show the same picture in all frames although the camera turns.

A bonnet, a logo, a subtitle, a letterbox and the pattern noise of a sensor are fixed on the sensor.
Far points stay at rest as well if the camera only translates. So frames are compared only if points
at infinity have to move.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.epipolar_fit import MAD_TO_DEVIATION
from tisfm.reconstruction.frames.image_motion import flow_scale, shrink_for_flow
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path_checks.evidence import measure_turn
from tisfm.reconstruction.path_checks.settings import PATH_CHECKS
from tisfm.reconstruction.result.path_check import LIMITS


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedTexture:
    """Texture that is fixed on the sensor, in frames that are far apart in time."""

    mask: np.ndarray  # (H, W) bool: fixed texture with a margin of half a window
    fixed_share: float  # share of the pixels of the frame that have fixed texture
    moving_share: float  # share of the pixels of the frame that have moving texture

    @property
    def share(self) -> float:
        """Share of the texture that is fixed; 0 without texture."""
        total = self.fixed_share + self.moving_share
        return self.fixed_share / total if total > 0 else 0.0


def find_infinity_motion(rotations: Sequence[np.ndarray], camera: Camera) -> float:
    """Return the largest motion of points at infinity from the first frame, px of the frames."""
    return max(
        camera.focal * np.radians(measure_turn(rotations[0].T @ other)) for other in rotations
    )


def camera_turns(pieces: Sequence[Piece], frames: PreparedFrames) -> bool:
    """Return whether points at infinity move enough in the largest piece of a path."""
    if not pieces:
        return False
    poses = max((piece.poses for piece in pieces), key=len)
    rotations = [pose[:3, :3] for pose in poses.values()]
    grey = frames.grey(0)
    motion = find_infinity_motion(rotations, frames.camera) * flow_scale(
        shrink_for_flow(grey), grey
    )
    return motion > LIMITS.min_infinity_motion


def find_fixed_pixels(frames: PreparedFrames) -> np.ndarray | None:
    """Return the pixels that are fixed on the sensor, (H, W) bool; None if there are hardly any.

    Far points may be among them if the camera did not turn. If nearly all pixels are fixed, the
    camera did not move, and the result is None.
    """
    numbers = spread_evenly(range(frames.count), PATH_CHECKS.max_fixed_frames)
    if len(numbers) < PATH_CHECKS.min_fixed_frames:
        return None
    texture = measure_fixed_texture([frames.grey(number) for number in numbers])
    is_overlay = (
        texture.share > LIMITS.max_fixed_share
        and texture.moving_share > PATH_CHECKS.min_moving_share
    )
    return texture.mask if is_overlay else None


def measure_fixed_texture(
    frames: Sequence[np.ndarray],  # (H, W) uint8 or float32 grey levels, of frames far apart
) -> FixedTexture:
    """Return the texture that is fixed on the sensor."""
    small = [shrink_for_flow(np.asarray(frame, np.float32)) for frame in frames]
    stack = np.stack(small)
    middle = find_median(stack)
    window = (PATH_CHECKS.fixed_window,) * 2
    deviation = cv2.boxFilter(find_median(np.abs(stack - middle)), -1, window)
    texture_of_median = cv2.boxFilter(measure_gradient(middle), -1, window)
    texture = find_median(
        np.stack([cv2.boxFilter(measure_gradient(frame), -1, window) for frame in small])
    )
    is_textured = texture > PATH_CHECKS.min_fixed_gradient
    shift = (
        MAD_TO_DEVIATION
        * deviation
        / np.maximum(texture_of_median, PATH_CHECKS.min_median_gradient)
    )
    is_fixed = (
        is_textured
        & (shift < PATH_CHECKS.max_fixed_shift)
        # the median over frames blurs texture that moves
        & (texture_of_median > PATH_CHECKS.min_fixed_texture * texture)
    )
    small_mask = cv2.dilate(is_fixed.astype(np.uint8), np.ones(window, np.uint8))
    height, width = frames[0].shape
    factor = 1 / flow_scale(small[0], frames[0])
    mask = cv2.resize(small_mask, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    fixed_share = float(is_fixed.mean())
    return FixedTexture(
        mask=mask[:height, :width] > 0,
        fixed_share=fixed_share,
        moving_share=float(is_textured.mean()) - fixed_share,
    )


def find_median(
    stack: np.ndarray,  # (N, H, W)
) -> np.ndarray:
    """Return the median over the first axis; `np.median` takes three times as long."""
    ordered = np.sort(stack, axis=0)
    return np.asarray((ordered[(len(stack) - 1) // 2] + ordered[len(stack) // 2]) / 2)


def measure_gradient(grey: np.ndarray) -> np.ndarray:
    """Return the length of the gradient, (H, W) float32, grey levels per px."""
    gradients = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    return cv2.magnitude(*gradients)


def spread_evenly(numbers: Sequence[int], limit: int) -> list[int]:
    """Return at most `limit` of the numbers, evenly spread."""
    indices = np.linspace(0, len(numbers) - 1, min(len(numbers), limit)).astype(int)
    return [numbers[k] for k in np.unique(indices)]
