"""Where the pixels of frame 0 lie in frame 1 under a motion and their depth."""

from typing import NamedTuple

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.motion.sparse_start import depth_flow


class MovedPixels(NamedTuple):
    """Nearest pixels of frame 1, and the depth there."""

    rows: np.ndarray  # (H, W) int64, inside frame 1
    columns: np.ndarray  # (H, W) int64, inside frame 1
    is_inside: np.ndarray  # (H, W) bool: whether the pixel moves to a pixel of frame 1
    depth: np.ndarray  # (H, W): D of the point in the axes of frame 1


def move_pixels(
    depth: np.ndarray,  # (H, W) float32: D of frame 0
    motion: np.ndarray,  # (3, 4): R and t
    camera: Camera,  # a pinhole
) -> MovedPixels:
    """Move every pixel of frame 0 to frame 1."""
    height, width = depth.shape
    flow = depth_flow(depth, motion, camera)
    columns = np.rint(flow[..., 0] + np.arange(width)).astype(np.int64)
    rows = np.rint(flow[..., 1] + np.arange(height)[:, None]).astype(np.int64)
    is_inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    cx, cy = camera.center_for(height, width)
    x, y = (np.arange(width) - cx) / camera.focal, (np.arange(height)[:, None] - cy) / camera.focal
    z = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2] + depth * motion[2, 3] / camera.focal
    return MovedPixels(
        rows.clip(0, height - 1),
        columns.clip(0, width - 1),
        is_inside,
        depth / np.maximum(z, MIN_DEPTH_RATIO),
    )
