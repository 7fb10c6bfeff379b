"""The first motion of frames far apart: the rotation of frame 1 is undone by matched points."""

from dataclasses import replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.first_motion import FirstMotion, first_motion, matched_motion
from tisfm.motion.problems import pyramid_of
from tisfm.motion.sparse_start import sparse_start
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.occlusion import leaves_image

BEYOND = 15  # px: window around a pixel outside frame 1 in which the flow is unreliable


def wide_baseline_motion(
    pyramid: ImagePyramid,
    settings: Settings,
    start: FirstMotion,  # first motion of a flow field alone, on the finest level
    # grey0, grey1: (H, W) float32, grey levels of the frames
    grey0: np.ndarray,
    grey1: np.ndarray,
) -> FirstMotion:
    """Return a first motion and a flow field for frames where a flow field alone fails.

    Matches give the rotation of the camera. Frame 1 is resampled without this rotation. Then it
    differs from frame 0 only by parallax and moving objects, which a flow field shows. Pixels that
    frame 1 does not see do not count. If this flow field fails as well, the result is the motion
    of the matches and its flow.
    """
    sparse = sparse_start(pyramid, start.level, None)
    if sparse is None:
        return start
    matched = matched_motion(start, sparse)
    if matched.status == "unrelated":
        return matched
    camera = pyramid.cameras[0]
    homography = _rotation_homography(matched.rotation, camera, *grey0.shape)
    rotated1 = cv2.warpPerspective(
        grey1,
        homography,
        grey0.shape[::-1],
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    height, width = grey0.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    positions = np.stack([columns, rows], axis=-1)
    leaves = leaves_image(
        np.moveaxis(cv2.perspectiveTransform(positions, homography) - positions, -1, 0)
    )
    hidden = cv2.dilate(leaves.astype(np.uint8), np.ones((BEYOND, BEYOND), np.uint8)) > 0
    flow_motion = first_motion(
        pyramid_of(grey0, rotated1, camera, settings, _rotated_valid_pixels(pyramid, homography)),
        settings,
        hidden=hidden,
    )
    if flow_motion.status in ("unrelated", "no_texture", "aperture"):
        return matched
    flow = cv2.perspectiveTransform(positions + flow_motion.flow, homography) - positions
    status = flow_motion.status
    if status == "no_motion":
        # The original frame 1 did move: the camera turned.
        status = Status(
            "pure_rotation",
            "too little parallax for depth: the camera only rotated; move the camera between "
            "frames",
        )
    return replace(
        flow_motion,
        rotation=matched.rotation @ flow_motion.rotation,
        translation=matched.rotation @ flow_motion.translation,
        status=status,
        flow=flow,
        trust=np.where(leaves_image(np.moveaxis(flow, -1, 0)), 0, flow_motion.trust),
        history=matched.history + flow_motion.history,
        uses_matches=True,
    )


def _rotated_valid_pixels(
    pyramid: ImagePyramid, homography: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pixels of frame 0 and of the turned frame 1 that count; None for all."""
    if pyramid.counted is None:
        return None
    counted0, counted1 = pyramid.counted.whole
    rotated = cv2.warpPerspective(
        counted1.astype(np.float32),
        homography,
        counted0.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return counted0, rotated == 1


def _rotation_homography(
    rotation: np.ndarray, camera: Camera, height: int, width: int
) -> np.ndarray:
    """Return the homography of pixels under a rotation, (3, 3)."""
    cx, cy = camera.center_for(height, width)
    matrix = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    return matrix @ rotation @ np.linalg.inv(matrix)
