"""The frames of a piece for tracking, and points with their observations in some of them."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from tisfm.checks import Floats
from tisfm.exports.frame_files import picture_of
from tisfm.exports.guided_matching import Pose
from tisfm.reconstruction.result.folder import depth_path
from tisfm.reconstruction.result.reconstruction import Reconstruction

MIN_OBSERVATIONS = 3  # of a point; 2 in a piece of two frames; set by hand
CACHED_FRAMES = 24  # frames in memory; set by hand


@dataclass(frozen=True, kw_only=True)
class SeenPoints:
    """Points, and their observations in M frames."""

    frames: list[int]  # numbers of the M frames
    # (N, M, 2) float64: (x, y), px from the centre of the upper left pixel; NaN for no observation
    image_points: Floats
    positions: Floats  # (N, 3) float64: in the world
    # (N, M) float64: distance from the projected point, px; NaN for no observation
    residual: Floats
    colors: np.ndarray  # (N, 3) uint8


class PieceFrames:
    """The frames of a piece; some pictures stay in memory."""

    def __init__(self, result: Reconstruction, piece: int) -> None:
        self.result = result
        # frame numbers, ascending
        self.numbers: list[int] = np.flatnonzero(result.piece == piece).tolist()
        self.keyframes = [k for k in result.keyframes if result.piece[k] == piece]
        # least number of frames that observe a point
        self.min_observations = min(MIN_OBSERVATIONS, max(2, len(self.numbers)))
        self.grey = lru_cache(CACHED_FRAMES)(self._read_grey)
        self.usable = lru_cache(CACHED_FRAMES)(self._read_usable)

    def has_depth(self, frame: int) -> bool:
        """Return whether a frame has depth."""
        return depth_path(self.result.folder, frame).exists()

    def pose(self, frame: int) -> Pose:
        """Return camera and pose of a frame."""
        return Pose(camera=self.result.camera, matrix=self.result.poses[frame])

    def colors(self, frame: int, image_points: np.ndarray) -> np.ndarray:
        """Return the colours of the nearest pixels of a frame, (N, 3) uint8."""
        column, row = np.rint(image_points).astype(np.intp).T
        colors = picture_of(self.result, frame)[row, column]
        return np.repeat(colors[:, None], 3, axis=1) if colors.ndim == 1 else colors

    def _read_grey(self, frame: int) -> np.ndarray:
        picture = picture_of(self.result, frame)
        if picture.ndim == 2:
            return picture
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))

    def _read_usable(self, frame: int) -> np.ndarray:
        """Return the pixels of the static scene that are not masked, (H, W) bool."""
        usable = self.result.labels(frame) == 0
        known = np.isfinite(self.result.inverse_depth_std(frame))
        if known.any():
            usable &= known
        return np.asarray(usable)
