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
    far = sparse_start(pyramid, start.level, None)
    if far is None:
        return start
    matched = matched_motion(start, far)
    if matched.status == "unrelated":
        return matched
    camera = pyramid.cameras[0]
    turn = _homography(matched.rotation, camera, *grey0.shape)
    turned = cv2.warpPerspective(
        grey1,
        turn,
        grey0.shape[::-1],
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    height, width = grey0.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    places = np.stack([columns, rows], axis=-1)
    gone = leaves_image(np.moveaxis(cv2.perspectiveTransform(places, turn) - places, -1, 0))
    unseen = cv2.dilate(gone.astype(np.uint8), np.ones((BEYOND, BEYOND), np.uint8)) > 0
    found = first_motion(
        pyramid_of(grey0, turned, camera, settings, _turned_counted(pyramid, turn)),
        settings,
        unseen=unseen,
    )
    if found.status in ("unrelated", "no_texture", "aperture"):
        return matched
    flow = cv2.perspectiveTransform(places + found.flow, turn) - places
    status = found.status
    if status == "no_motion":
        # The original frame 1 did move: the camera turned.
        status = Status(
            "pure_rotation",
            "too little parallax to see depth by: the camera only turned; it has to change its "
            "place",
        )
    return replace(
        found,
        rotation=matched.rotation @ found.rotation,
        translation=matched.rotation @ found.translation,
        status=status,
        flow=flow,
        trust=np.where(leaves_image(np.moveaxis(flow, -1, 0)), 0, found.trust),
        history=matched.history + found.history,
        matched=True,
    )


def _turned_counted(
    pyramid: ImagePyramid, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pixels of frame 0 and of the turned frame 1 that count; None for all."""
    if pyramid.counted is None:
        return None
    counted0, counted1 = pyramid.counted.whole
    turned = cv2.warpPerspective(
        counted1.astype(np.float32),
        turn,
        counted0.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return counted0, turned == 1


def _homography(rotation: np.ndarray, camera: Camera, height: int, width: int) -> np.ndarray:
    """Return the homography of pixels under a rotation, (3, 3)."""
    cx, cy = camera.center_for(height, width)
    matrix = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    return matrix @ rotation @ np.linalg.inv(matrix)
