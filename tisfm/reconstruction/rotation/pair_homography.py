"""The homography between two frames, from points that both show."""

import cv2
import numpy as np

from tisfm.reconstruction.rotation.frame_pairs import FramePair
from tisfm.reconstruction.rotation.settings import FRAME_SIDE, ROTATION


def fit_homography(pair: FramePair, longer_side: int) -> float:
    """Return the median residual of the best homography of a pair, px; infinite for none.

    `longer_side` is the longer side of the frames, px.
    """
    tolerance = ROTATION.inlier_pixels * longer_side / FRAME_SIDE
    matrix, _ = cv2.findHomography(pair.before, pair.after, cv2.RANSAC, tolerance)
    if matrix is None:
        return np.inf
    mapped = cv2.perspectiveTransform(pair.before[None], matrix)[0]
    return float(np.median(np.hypot(*(mapped - pair.after).T)))
