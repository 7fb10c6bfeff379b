"""The camera path from static pixels, in a scene with moving objects."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS, ImageMotion
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.label_propagation import propagate_labels
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels, enlarge_labels
from tisfm.reconstruction.path.path_solver import CameraPath
from tisfm.reconstruction.result.calibration import Calibrate


def find_static_path(
    frames: PreparedFrames,  # the labels are stored in them
    search: SequenceLabels | None,  # with all frames added; None if the frames have given labels
    # Returns the path of the frames in their present state. Its argument states which camera
    # parameters are calibrated.
    find_path: Callable[[Calibrate | None], CameraPath],
    # sets the camera of the frames to that of a path, and prepares the frames anew if needed
    set_camera: Callable[[CameraPath], None],
) -> CameraPath:
    """Label the moving objects, unless labels are given, and return the path of the static rest.

    The first labels need no path. With the path that follows, many frames give evidence for better
    labels; if a label changes, the path is found again. If the path has a lens distortion or a
    rolling shutter, the frames are undistorted first, and all starts again as if this camera had
    been given.
    """
    if search is not None:
        _set_labels(frames, search.labels())
    path = find_path(None)
    focal = path.focal
    calibrate: Calibrate | None = None
    if search is not None and (path.rolling is not None or not path.camera.is_pinhole):
        set_camera(path)
        search, calibrate = SequenceLabels(frames.camera), "nothing"
        for number in range(frames.count):
            search.add(frames.tracker_input(number)[0])
        _set_labels(frames, search.labels())
        path = find_path(calibrate)
    if search is not None and _set_labels(
        frames, search.labels(_largest_piece_poses(path, frames.count), path.camera.pinhole())
    ):
        path = find_path(calibrate)
    set_camera(path)
    return path if calibrate is None else replace(path, focal=focal)


def label_remaining_frames(frames: PreparedFrames, labelled_frames: Sequence[int]) -> None:
    """Propagate the labels of the `labelled_frames`, in order, to the frames without labels."""
    if len(labelled_frames) == frames.count:
        return
    motion = ImageMotion(frames.camera, TRACKING_SETTINGS)
    for number in range(frames.count):
        motion.add(frames.tracker_input(number)[0])
    height, width = motion.grey(0).shape

    def labels_of(number: int) -> np.ndarray:
        size = (width, height)
        return cv2.resize(frames.labels(number), size, interpolation=cv2.INTER_NEAREST_EXACT)

    for number, labels in propagate_labels(motion, labelled_frames, labels_of):
        frames.set_labels(number, enlarge_labels(labels, motion.scale, frames.shape))


def _set_labels(frames: PreparedFrames, labels: Iterable[np.ndarray]) -> bool:
    """Label every frame, and return whether any label changed."""
    return any(
        [frames.set_labels(number, frame_labels) for number, frame_labels in enumerate(labels)]
    )


def _largest_piece_poses(path: CameraPath, count: int) -> list[np.ndarray | None]:
    """Return the poses of the largest piece, by frame."""
    poses: list[np.ndarray | None] = [None] * count
    if path.pieces:
        largest = max(path.pieces, key=lambda piece: len(piece.poses))
        for frame, pose in largest.poses.items():
            poses[frame] = pose
    return poses
