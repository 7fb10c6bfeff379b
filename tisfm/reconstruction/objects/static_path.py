"""The path through what is at rest, where things move on their own."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from tisfm.reconstruction.frames.frame_flow import TRACKING_SETTINGS
from tisfm.reconstruction.frames.image_motion import ImageMotion
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.label_propagation import propagate_labels
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels, enlarge_labels
from tisfm.reconstruction.path.path_solver import CameraPath
from tisfm.reconstruction.result.calibration import Calibrate


def find_static_path(
    frames: PreparedFrames,
    labels: SequenceLabels | None,
    path_of: Callable[[Calibrate | None], CameraPath],
    take_camera: Callable[[CameraPath], None],
) -> CameraPath:
    """Label what moves on its own, unless it is, and return the path that is left.

    The first labels need no path. Under that which they leave, many frames say more. If frames are
    made anew for a lens or a shutter that was found with it, all begins again with these, as if
    that camera had been given.

    Parameters
    ----------
    frames : PreparedFrames
        They take the labels.
    labels : SequenceLabels or None
        That has the frames; None where they have labels that are given.
    path_of : callable
        Returns the path of the frames as they are; what of the camera is found may be stated.
    take_camera : callable
        Lets frames have the camera of a path, and makes them anew where it asks for that.
    """
    if labels is not None:
        _label(frames, labels.found())
    path = path_of(None)
    focal = path.focal
    calibrate: Calibrate | None = None
    if labels is not None and (path.rolling is not None or not path.camera.is_pinhole):
        take_camera(path)
        labels, calibrate = SequenceLabels(frames.camera), "nothing"
        for number in range(frames.count):
            labels.add(frames.tracked(number)[0])
        _label(frames, labels.found())
        path = path_of(calibrate)
    if labels is not None and _label(
        frames, labels.found(_poses(path, frames.count), path.camera.pinhole())
    ):
        path = path_of(calibrate)
    take_camera(path)
    return path if calibrate is None else replace(path, focal=focal)


def label_remaining_frames(frames: PreparedFrames, known: Sequence[int]) -> None:
    """Carry the labels of frames that have some, in order, to those that have none."""
    if len(known) == frames.count:
        return
    motion = ImageMotion(frames.camera, TRACKING_SETTINGS)
    for number in range(frames.count):
        motion.add(frames.tracked(number)[0])
    height, width = motion.grey(0).shape

    def labelled(number: int) -> np.ndarray:
        size = (width, height)
        return cv2.resize(frames.labels(number), size, interpolation=cv2.INTER_NEAREST_EXACT)

    for number, labels in propagate_labels(motion, known, labelled):
        frames.label(number, enlarge_labels(labels, motion.share, frames.shape))


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
