"""Dense rays between two frames of a path, and the motion that fits them best.

The path follows from tracks. The flow of a pair is computed without the path, so that it may
contradict the path.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.egomotion import (
    TooFewPixelsError,
    camera_motion,
    deviation_from_pose,
    refine_motion,
)
from tisfm.motion.epipolar_fit import Pose, Rays
from tisfm.reconstruction.frames.image_motion import (
    TRACKING_SETTINGS,
    find_flow,
    flow_scale,
    pixel_grid,
    sample_image,
    shrink_for_flow,
)
from tisfm.reconstruction.path_checks.settings import PATH_CHECKS
from tisfm.reconstruction.result.path_check import LIMITS


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
    # (h, w, 2) float32: image motion, px of the shrunk frames; by default it is computed
    flow: np.ndarray | None = None,
) -> DensePair | None:
    """Return the rays and motions of a pair; None if there are too few textured pixels."""
    small0, small1 = shrink_for_flow(first[1]), shrink_for_flow(second[1])
    scale = flow_scale(small0, first[1])
    if flow is None:
        flow = find_flow(small0, small1, scale, camera, TRACKING_SETTINGS)
    height, width = small0.shape
    size = width, height
    static = cv2.resize(is_static.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    used = find_textured_pixels(small0) & static
    border = PATH_CHECKS.border
    used[:border] = used[-border:] = False
    used[:, :border] = used[:, -border:] = False
    used &= find_matching_pixels(small0, small1, flow, used)
    rows, columns = np.nonzero(used)
    baseline = float(np.linalg.norm(motion[:3, 3]))
    if len(rows) < PATH_CHECKS.min_pixels or baseline == 0:
        return None
    small_camera = camera.scaled(scale, *first[1].shape)
    path = motion[:3, :3], motion[:3, 3] / baseline
    confidence = used.astype(np.float32)
    try:
        # Where the path explains the image motion, no other motion does so clearly better: the
        # motion near the path is enough, which takes a fraction of the time.
        residual = deviation_from_pose(flow, confidence, small_camera, *path)
        free = (
            refine_motion(flow, confidence, small_camera, path)
            if residual < LIMITS.max_residual_ratio * PATH_CHECKS.min_residual
            else camera_motion(flow, confidence, small_camera)
        )
    except TooFewPixelsError:
        return None
    stride = max(1, len(rows) // PATH_CHECKS.max_rays)
    rows, columns = rows[::stride], columns[::stride]
    cx, cy = small_camera.center_for(height, width)
    positions = np.stack([columns - cx, rows - cy]).astype(np.float64)
    displacements = flow[rows, columns].T
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
        path=path,
        free=(free.rotation, free.translation / np.linalg.norm(free.translation)),
    )


def find_matching_pixels(
    # grey0, grey1: (h, w) float32 grey levels
    grey0: np.ndarray,
    grey1: np.ndarray,
    flow: np.ndarray,  # (h, w, 2) float32: px
    is_textured: np.ndarray,  # (h, w) bool: pixels of the first frame that are compared
) -> np.ndarray:
    """Return the pixels whose neighbourhood looks alike where the flow leads, (h, w) bool.

    Hidden pixels and a wrong flow make neighbourhoods differ more than most. The difference is
    divided by the texture, so it is a shift in px. A change of the light of a neighbourhood does
    not count.
    """
    height, width = grey0.shape
    positions = pixel_grid(grey0.shape) + flow
    difference = grey0 - sample_image(grey1, positions)
    window = (PATH_CHECKS.match_window,) * 2
    difference -= cv2.boxFilter(difference, -1, window)
    gradient_x, gradient_y = (
        cv2.Sobel(grey0, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1))
    )
    texture = cv2.boxFilter(cv2.magnitude(gradient_x, gradient_y), -1, window)
    shift = cv2.boxFilter(np.abs(difference), -1, window) / (texture + PATH_CHECKS.texture_floor)
    x, y = cv2.split(positions)
    is_inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1) & is_textured
    if not is_inside.any():
        return is_inside
    usual = float(np.median(shift[is_inside]))
    limit = PATH_CHECKS.max_relative_shift * max(usual, PATH_CHECKS.min_usual_shift)
    return np.asarray(is_inside & (shift < limit))


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
