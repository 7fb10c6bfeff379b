"""Path and depth of a thing that moves on its own, in axes of its own.

To a thing, the camera is what moves: its path and depth are found as those of a sequence at rest
are, from what belongs to the thing alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.objects.contacts import contact_scale
from tisfm.reconstruction.depths import FrameDepth, PieceDepths, effort_of
from tisfm.reconstruction.frames import PreparedFrames
from tisfm.reconstruction.moving_object import MovingObject, ScaleFrom
from tisfm.reconstruction.path import PathFinder
from tisfm.reconstruction.tracks import CELLS
from tisfm.reconstruction.way import Piece
from tisfm.settings import Settings

FEWEST_FRAMES, FEWEST_PIXELS = 3, 400
RIM = 5  # px that no track comes nearer to the thing's border, across
FINEST = 6  # px from track to track
# Of its points along an axis: the extent leaves out as many at both ends.
OUTLYING = 0.03
AROUND = 15  # px about a thing, that may tell how far away it is


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


def placed(
    thing: MovingObject,
    own: OwnPath,
    poses: np.ndarray,
    inverse_depth: Callable[[int], np.ndarray],
    labelled: Callable[[int], np.ndarray],
) -> tuple[MovingObject, float]:
    """Return a thing with its path in the world, and what its own depth is multiplied by there.

    Parameters
    ----------
    thing : MovingObject
    own : OwnPath
    poses : (N, 4, 4) array
        Of the camera, camera to world.
    inverse_depth : callable
        Returns that of a frame at rest, (H, W), of the world's unit.
    labelled : callable
        Returns the labels of a frame, (H, W).
    """
    contacts, around = [], []
    for depth in own.depths:
        frame = own.frames[depth.frame]
        behind, labels = inverse_depth(frame), labelled(frame)
        mine = labels == thing.id
        sure = mine & np.isfinite(depth.deviation) & (depth.inverse_depth > 0)
        if not sure.any() or not np.isfinite(behind).any():
            continue
        both = np.where(mine, depth.inverse_depth, behind).astype(np.float32)
        contact = contact_scale(both, labels, mine & ~sure, thing.id)
        if contact is not None:
            contacts.append(1 / contact)
        window = np.ones((2 * AROUND + 1, 2 * AROUND + 1), np.uint8)
        ring = (cv2.dilate(np.uint8(mine), window) > 0) & (labels == 0) & (behind > 0)
        if ring.any():
            # It hides what is around it, so it is at least as near as the nearest there.
            nearest = np.quantile(behind[ring], 0.9)
            around.append(float(np.median(depth.inverse_depth[sure]) / nearest))
    scale_from: ScaleFrom = "around"
    if len(contacts) >= max(2, len(own.depths) / 4):
        scale, scale_from = float(np.median(contacts)), "contact"
    elif around:
        scale = float(np.median(around))
    else:
        scale, scale_from = 1.0, "none"
    points = np.array([*own.piece.points.values()]).reshape(-1, 3)
    middle = np.median(points, axis=0)
    low, high = np.quantile(points, [OUTLYING, 1 - OUTLYING], axis=0)
    moved = np.eye(4)
    moved[:3, 3] = -middle
    at = {frame: k for k, frame in enumerate(thing.frames)}
    found = thing.poses.copy()
    for number, pose in own.piece.poses.items():
        frame = own.frames[number]
        own_to_camera = np.linalg.inv(moved @ pose)  # of the object, in its own unit
        own_to_camera[:3, 3] *= scale
        found[at[frame]] = poses[frame] @ own_to_camera
    return (
        replace(thing, poses=found, extent=scale * (high - low), scale_from=scale_from),
        scale,
    )
