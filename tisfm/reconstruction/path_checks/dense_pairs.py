"""Dense rays between two frames of a path, and the motion that fits them best.

The path follows from tracks. The flow of a pair is computed without the path, so that it may
contradict the path.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion
from tisfm.motion.epipolar_fit import Pose, Rays
from tisfm.reconstruction.frames.image_motion import (
    TRACKING_SETTINGS,
    consistency_mask,
    find_flow,
    flow_scale,
    shrink_for_flow,
)
from tisfm.reconstruction.path_checks.settings import PATH_CHECKS


@dataclass(frozen=True, kw_only=True, eq=False)
class DensePair:
    """Rays of the textured static pixels of a pair, and two motions: the path's and a free one."""

    first: int  # number of the frame of the rays
    second: int
    shape: tuple[int, int]  # height and width of the shrunk frames
    rows: np.ndarray  # (N,) int: pixels of the rays in the shrunk frame
    columns: np.ndarray  # (N,) int
    rays: Rays
    path: Pose  # R and t of the path, ‖t‖ = 1
    free: Pose  # R and t of the motion that fits the rays best, ‖t‖ = 1


def find_dense_pair(
    # first, second: (number, (H, W) uint8 grey levels) of two frames
    first: tuple[int, np.ndarray],
    second: tuple[int, np.ndarray],
    motion: np.ndarray,  # (4, 4): from the first camera to the second, P₁ = R P₀ + t
    camera: Camera,  # pinhole camera of the frames
    is_static: np.ndarray,  # (H, W) bool: pixels of the first frame that show the static scene
) -> DensePair | None:
    """Return the rays and motions of a pair; None if there are too few textured pixels."""
    small0, small1 = shrink_for_flow(first[1]), shrink_for_flow(second[1])
    scale = flow_scale(small0, first[1])
    forward, backward = (
        find_flow(*frames, scale, camera, TRACKING_SETTINGS)
        for frames in ((small0, small1), (small1, small0))
    )
    height, width = small0.shape
    size = width, height
    static = cv2.resize(is_static.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    used = (consistency_mask(forward, backward) > 0) & find_textured_pixels(small0) & static
    border = PATH_CHECKS.border
    used[:border] = used[-border:] = False
    used[:, :border] = used[:, -border:] = False
    rows, columns = np.nonzero(used)
    baseline = float(np.linalg.norm(motion[:3, 3]))
    if len(rows) < PATH_CHECKS.min_pixels or baseline == 0:
        return None
    small_camera = camera.scaled(scale, *first[1].shape)
    try:
        free = camera_motion(forward, used.astype(np.float32), small_camera)
    except TooFewPixelsError:
        return None
    cx, cy = small_camera.center_for(height, width)
    positions = np.stack([columns - cx, rows - cy]).astype(np.float64)
    displacements = forward[rows, columns].T
    return DensePair(
        first=first[0],
        second=second[0],
        shape=(height, width),
        rows=rows,
        columns=columns,
        rays=Rays(
            rays0=np.vstack([positions / small_camera.focal, np.ones(len(rows))]),
            rays1=(positions + displacements) / small_camera.focal,
            trust=np.ones(len(rows)),
            focal=small_camera.focal,
        ),
        path=(motion[:3, :3], motion[:3, 3] / baseline),
        free=(free.rotation, free.translation / np.linalg.norm(free.translation)),
    )


def find_textured_pixels(
    grey: np.ndarray,  # (H, W) float32
) -> np.ndarray:
    """Return the pixels with texture in all directions, (H, W) bool."""
    window = (PATH_CHECKS.texture_window,) * 2
    gradient_x, gradient_y = (
        cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1))
    )
    xx, xy, yy = (
        cv2.boxFilter(product, -1, window)
        for product in (gradient_x**2, gradient_x * gradient_y, gradient_y**2)
    )
    mean, determinant = (xx + yy) / 2, xx * yy - xy**2
    smallest = mean - np.sqrt(np.maximum(mean**2 - determinant, 0))
    return np.asarray(smallest > PATH_CHECKS.min_texture)
