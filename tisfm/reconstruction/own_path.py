"""Path and depth of a thing that moves on its own, in axes of its own.

To a thing, the camera is what moves: its path and depth are found as those of a sequence at rest
are, from what belongs to the thing alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.depths import FrameDepth, PieceDepths, effort_of
from tisfm.reconstruction.frames import PreparedFrames
from tisfm.reconstruction.moving_object import MovingObject
from tisfm.reconstruction.path import PathFinder
from tisfm.reconstruction.tracks import CELLS
from tisfm.reconstruction.way import Piece
from tisfm.settings import Settings

FEWEST_FRAMES, FEWEST_PIXELS = 3, 400
RIM = 5  # px that no track comes nearer to the thing's border, across
FINEST = 6  # px from track to track


@dataclass(frozen=True, kw_only=True)
class OwnPath:
    """A thing's path and depth in a unit and axes of its own.

    Attributes
    ----------
    frames : list of int
        Of the sequence, by the numbers that piece and depth have.
    piece : Piece
        Camera to object, and the object's points.
    depths : list of FrameDepth
    """

    frames: list[int]
    piece: Piece
    depths: list[FrameDepth]

    def points(self) -> np.ndarray:
        """Return the object's points, (N, 3)."""
        return np.array([*self.piece.points.values()]).reshape(-1, 3)


class _FramesOf:
    """The frames of a sequence that show a thing, of which it alone counts.

    Parameters
    ----------
    frames : PreparedFrames
    numbers : sequence of int
    labelled : callable
        Returns the labels of a frame, (H, W).
    number : int
        Of the thing.
    """

    def __init__(
        self,
        frames: PreparedFrames,
        numbers: Sequence[int],
        labelled: Callable[[int], np.ndarray],
        number: int,
    ) -> None:
        self.camera: Camera = frames.camera
        self.shape = frames.shape
        self._frames, self._numbers = frames, numbers
        self._labelled, self._number = labelled, number

    def grey(self, number: int) -> np.ndarray:
        """Return a frame, (H, W) float32."""
        return self._frames.grey(self._numbers[number])

    def counted(self, number: int) -> np.ndarray:
        """Return where the thing is, (H, W) bool."""
        return self._labelled(self._numbers[number]) == self._number


def own_path(
    thing: MovingObject,
    frames: PreparedFrames,
    labelled: Callable[[int], np.ndarray],
    settings: Settings,
    *,
    with_depth: bool = True,
) -> OwnPath | str:
    """Return the path and depth of a thing, or why it has none.

    Parameters
    ----------
    thing : MovingObject
    frames : PreparedFrames
    labelled : callable
        Returns the labels of a frame, (H, W).
    settings : Settings
    with_depth : bool
        Or the path alone.
    """
    numbers = [
        frame for frame in thing.frames if (labelled(frame) == thing.id).sum() >= FEWEST_PIXELS
    ]
    if len(numbers) < FEWEST_FRAMES:
        return f"it is too small, or seen in fewer than {FEWEST_FRAMES} frames"
    own = _FramesOf(frames, numbers, labelled, thing.id)
    side = float(np.median(np.sqrt(thing.boxes[:, 2] * thing.boxes[:, 3])))
    longer = max(frames.shape)
    cells = min(CELLS * longer / max(side, 1.0), longer / FINEST)
    finder = PathFinder(frames.camera, readout=0.0, cells=max(CELLS, round(cells)))
    rim = np.ones((RIM, RIM), np.uint8)
    for number in range(len(numbers)):
        grey = np.rint(own.grey(number)).clip(0, 255).astype(np.uint8)
        finder.add(grey, cv2.erode(np.uint8(own.counted(number)), rim) == 0)
    try:
        path = finder.finish()
    except ValueError:  # what it shows is in no order
        return "what it shows from frame to frame does not fit together"
    if not path.pieces:
        return "it does not turn or come nearer enough, or is not rigid: its motion shows no depth"
    piece = max(path.pieces, key=lambda one: len(one.poses))
    depths: list[FrameDepth] = []
    if with_depth:
        depths += PieceDepths(own, piece, path.seen, settings, effort=effort_of(settings))
    return OwnPath(frames=numbers, piece=piece, depths=depths)
