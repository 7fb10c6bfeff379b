"""Weights of the matched planes of a window, from the certainty of their inverse depth D.

The only texture of a matched window may lie at the border of the window, as at the outline of an
object before a wall without texture. Such a match does not give the depth of the centre. For this
reason the weight of a cell depends on the texture close to the cell.
"""

import cv2
import numpy as np

from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.motion.matched_planes import noise_deviation
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.window_planes import Window, WindowPlanes

# Variance of the Sobel gradient of noise with the variance 1; an exact value.
SOBEL_NOISE_GAIN = 3 / 16


def match_weights(window: Window, planes: WindowPlanes) -> np.ndarray:
    """Return the weight, from 0 to 1, and the matched D of every cell, (2, h, w) float32."""
    depth = planes.inverse_depth
    if planes.is_reliable.any():
        depth = np.where(planes.is_reliable, depth, np.median(depth[planes.is_reliable]))
    deviation = match_deviation(window, depth.astype(np.float32))
    weight = np.where(
        planes.is_reliable, 1 / (1 + (deviation / DEPTH.half_weight_match_deviation) ** 2), 0
    )
    return np.stack([weight, np.where(weight > 0, depth, 0)]).astype(np.float32)


def match_deviation(
    window: Window,
    inverse_depth: np.ndarray,  # (h, w) float32: D, cells
) -> np.ndarray:  # (h, w) float32: infinite where the image is flat
    """Return the standard deviation of D, in cells, that the image around each cell allows.

    This is the deviation of a least-squares fit of D to grey levels with noise σ: σ_D² =
    2 σ² / Σ (∇I·∂x/∂D)². The sum goes over nearby cells and the best frames.
    """
    frame = window.at_cell_level(0)
    noise = noise_deviation(frame) ** 2
    gradients = [
        cv2.Sobel(frame, cv2.CV_32F, *axis, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
        for axis in ((1, 0), (0, 1))
    ]
    total = np.zeros_like(frame)
    for slope_x, slope_y in _position_slopes(window, inverse_depth):
        total += (gradients[0] * slope_x + gradients[1] * slope_y) ** 2
        total -= np.float32(SOBEL_NOISE_GAIN * noise) * (slope_x**2 + slope_y**2)
    total *= np.float32(window.best_count / len(window.motions))
    window_sum = cv2.boxFilter(
        total, -1, (DEPTH.certainty_window, DEPTH.certainty_window), normalize=False
    )
    with np.errstate(divide="ignore"):
        deviation: np.ndarray = np.sqrt(np.float32(2 * noise) / np.maximum(window_sum, 0))
    return deviation


def _position_slopes(
    window: Window, inverse_depth: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return ∂x/∂D of every cell in every frame, px/px, along x and along y."""
    height, width = inverse_depth.shape
    camera = window.camera_of(window.level)
    cx, cy = camera.center_for(*window.frames[0][window.level].shape)
    x = (np.arange(width, dtype=np.float32) - np.float32(cx)) / np.float32(camera.focal)
    y = (np.arange(height, dtype=np.float32)[:, None] - np.float32(cy)) / np.float32(camera.focal)
    scaled_depth = inverse_depth / np.float32(camera.focal)
    slopes = []
    for motion in window.motions.astype(np.float32):
        p1, p2, p3 = (row[0] * x + row[1] * y + row[2] + row[3] * scaled_depth for row in motion)
        p3 = np.maximum(p3, np.float32(MIN_DEPTH_RATIO))
        t1, t2, t3 = motion[:, 3]
        slopes.append(((t1 - p1 / p3 * t3) / p3, (t2 - p2 / p3 * t3) / p3))
    return slopes
