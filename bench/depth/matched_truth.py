"""Truth for sequences of which only the poses are known: matched points, triangulated."""

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.frames import grey_pair
from tisfm.motion.sparse_matches import sparse_matches

OFF = 0.7  # px, at most, between a point and where it is seen, in both frames


def depth_of_matches(
    frame0: NDArray, frame1: NDArray, camera: Camera, pose: NDArray
) -> NDArray[np.float32]:
    """Return the depth of frame 0, (H, W), where a matched point is, NaN elsewhere.

    Parameters
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) uint8
    camera : Camera
        A pinhole.
    pose : (4, 4) array
        True motion, P₁ = R P₀ + t; depth is in its unit.
    """
    matches = sparse_matches(*grey_pair(frame0, frame1))
    cx, cy = camera.center_for(*frame0.shape[:2])
    pinhole = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    views = [np.asarray(pinhole @ motion) for motion in (np.eye(3, 4), pose[:3])]
    points = cv2.triangulatePoints(views[0], views[1], matches.before.T, matches.after.T)
    points = points / points[3]
    met = points[2] > 0
    for view, seen in zip(views, (matches.before, matches.after), strict=True):
        image = view @ points
        met &= np.linalg.norm(image[:2] / image[2] - seen.T, axis=0) <= OFF
    depth = np.full(frame0.shape[:2], np.nan)
    columns, rows = np.rint(matches.before[met]).astype(int).T
    depth[rows, columns] = points[2, met]
    return depth.astype(np.float32)
