"""The path through what is at rest, where things move on their own."""

from collections.abc import Callable, Iterable

import numpy as np

from tisfm.reconstruction.frames import PreparedFrames
from tisfm.reconstruction.path import CameraPath
from tisfm.reconstruction.sequence_labels import SequenceLabels


def path_at_rest(
    frames: PreparedFrames, labels: SequenceLabels, path_of: Callable[[], CameraPath]
) -> CameraPath:
    """Label what moves on its own, and return the path that is left.

    The first labels need no path. Under that which they leave, many frames say more.

    Parameters
    ----------
    frames : PreparedFrames
        They take the labels.
    labels : SequenceLabels
        That has the frames.
    path_of : callable
        Returns the path of the frames as they are.
    """
    _label(frames, labels.found())
    path = path_of()
    if _label(frames, labels.found(_poses(path, frames.count), path.camera.pinhole())):
        path = path_of()
    return path


def _label(frames: PreparedFrames, labels: Iterable[np.ndarray]) -> bool:
    """Label every frame, and return whether something else moves than before."""
    return any([frames.label(number, labelled) for number, labelled in enumerate(labels)])


def _poses(path: CameraPath, count: int) -> list[np.ndarray | None]:
    """Return the poses of the largest piece, by frame."""
    poses: list[np.ndarray | None] = [None] * count
    if path.pieces:
        largest = max(path.pieces, key=lambda piece: len(piece.poses))
        for frame, pose in largest.poses.items():
            poses[frame] = pose
    return poses
