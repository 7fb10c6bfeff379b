"""The frames of a piece as tracks go through them, and points that some of them see."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from tisfm.checks import Floats
from tisfm.exports.frame_files import picture_of
from tisfm.exports.guided_matching import Pose
from tisfm.reconstruction.result.folder import depth_path
from tisfm.reconstruction.result.reconstruction import Reconstruction

FEWEST = 3  # frames that see a point; 2 where a piece has no more
HELD = 24  # frames in memory


@dataclass(frozen=True, kw_only=True)
class SeenPoints:
    """Points, and where M frames see them.

    Attributes
    ----------
    frames : list of int
        M of them.
    places : (N, M, 2) float64
        (x, y), px from the upper left pixel's centre; NaN where a point is not seen.
    positions : (N, 3) float64
        In the world.
    residual : (N, M) float64
        From where pose and position say, px; NaN where a point is not seen.
    colors : (N, 3) uint8
    """

    frames: list[int]
    places: Floats
    positions: Floats
    residual: Floats
    colors: np.ndarray


class PieceFrames:
    """The frames of a piece; some of their pictures are held.

    Attributes
    ----------
    result : Reconstruction
    numbers : list of int
        Of the frames, ascending.
    keyframes : list of int
    fewest : int
        Frames that see a point.
    """

    def __init__(self, result: Reconstruction, piece: int) -> None:
        self.result = result
        self.numbers: list[int] = np.flatnonzero(result.piece == piece).tolist()
        self.keyframes = [k for k in result.keyframes if result.piece[k] == piece]
        self.fewest = min(FEWEST, max(2, len(self.numbers)))
        self.grey = lru_cache(HELD)(self._read_grey)
        self.usable = lru_cache(HELD)(self._read_usable)

    def has_depth(self, frame: int) -> bool:
        """Return whether there is depth of a frame."""
        return depth_path(self.result.folder, frame).exists()

    def pose(self, frame: int) -> Pose:
        """Return where the camera of a frame stood."""
        return Pose(camera=self.result.camera, matrix=self.result.poses[frame])

    def colors(self, frame: int, places: np.ndarray) -> np.ndarray:
        """Return the colours of a frame at the pixels nearest to places, (N, 3) uint8."""
        column, row = np.rint(places).astype(np.intp).T
        colors = picture_of(self.result, frame)[row, column]
        return np.repeat(colors[:, None], 3, axis=1) if colors.ndim == 1 else colors

    def _read_grey(self, frame: int) -> np.ndarray:
        picture = picture_of(self.result, frame)
        if picture.ndim == 2:
            return picture
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))

    def _read_usable(self, frame: int) -> np.ndarray:
        """Return the pixels of a frame that are at rest, and not masked, (H, W) bool."""
        usable = self.result.labels(frame) == 0
        known = np.isfinite(self.result.inverse_depth_std(frame))
        if known.any():
            usable &= known
        return np.asarray(usable)
