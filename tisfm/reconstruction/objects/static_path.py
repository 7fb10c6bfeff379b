"""The camera path from the static pixels, and the labels of the moving ones: each needs the other.

A path of all pixels that agrees with the image motion comes first. Labels that leave no such path
are wrong.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.reconstruction.objects.settings import OBJECTS
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.result.calibration import Calibrate

# Returns the path of the frames with their current labels and camera; its argument states which
# camera parameters are calibrated.
FindPath = Callable[[Calibrate | None], CameraPath]
# Returns whether the image motion of the unlabelled pixels agrees with a path.
Agrees = Callable[[CameraPath], bool]


def find_static_path(
    frames: PreparedFrames,  # this function stores the labels in the frames
    search: SequenceLabels | None,  # with all frames added; None if the user gave labels
    find_path: FindPath,
    # gives the frames the camera of a path, and prepares the frames anew if needed
    set_camera: Callable[[CameraPath], None],
    agrees: Agrees | None = None,  # None if the path of all pixels is known to be wrong
    plain_path: CameraPath | None = None,  # the path of all pixels; None if it is not yet known
) -> CameraPath:
    """Label the moving objects, unless labels are given, and return the path of the static pixels.

    If the path of all pixels agrees with the image motion, the labels are found with it. Otherwise,
    or if the camera states a readout, the first labels are found without a path.
    """
    if search is None or agrees is None or frames.camera.readout:
        return _find_from_first_labels(frames, search, find_path, set_camera)
    plain_path = plain_path or find_path(None)
    if not plain_path.is_plain or not plain_path.position_count:
        return _find_from_first_labels(frames, search, find_path, set_camera)
    if agrees(plain_path):
        path = _label_with_path(frames, search, plain_path, find_path, agrees)
        set_camera(path)
        return path

    def choose(path: CameraPath) -> CameraPath:
        """Return the path of all pixels if the labels mend it, and a new path is no better."""
        is_better = path.position_count >= plain_path.position_count and agrees(path)
        return path if is_better or not agrees(plain_path) else plain_path

    return _find_from_first_labels(frames, search, find_path, set_camera, choose)


def _find_from_first_labels(
    frames: PreparedFrames,
    search: SequenceLabels | None,
    find_path: FindPath,
    set_camera: Callable[[CameraPath], None],
    choose: Callable[[CameraPath], CameraPath] = lambda path: path,  # the path that is used instead
) -> CameraPath:
    """Label the moving objects, at first without a path, and return the path.

    With the path from the first labels, many frames give evidence for better labels; if a label
    changes, the path is found again. If the path has a lens distortion or a rolling shutter, the
    frames are undistorted first, and labels and path are found again as if the user had given this
    camera.
    """
    if search is not None:
        _set_labels(frames, search.labels())
    path = find_path(None)
    focal = path.focal
    calibrate: Calibrate | None = None
    if search is not None and (path.rolling is not None or not path.camera.is_pinhole):
        set_camera(path)
        search, calibrate = SequenceLabels.of_frames(frames), "nothing"
        _set_labels(frames, search.labels())
        path = find_path(calibrate)
    if search is not None and _relabel(frames, search, path):
        path = find_path(calibrate)
    if calibrate is None:
        path = choose(path)
    set_camera(path)
    return path if calibrate is None else replace(path, focal=focal)


def _label_with_path(
    frames: PreparedFrames,
    search: SequenceLabels,
    path: CameraPath,  # of all pixels; it agrees with their motion
    find_path: FindPath,
    agrees: Agrees,
) -> CameraPath:
    """Label the moving objects with the path of all pixels; return the path of the static pixels.

    A new path is used only if it agrees with the image motion, and has as many positions. If it has
    more, the labels are found once more. Labels are deleted if no path agrees with the motion of
    the other pixels, or if they cover most of the frames.
    """
    for _ in range(OBJECTS.label_rounds):
        if not _relabel(frames, search, path):
            return path
        shares = [(frames.labels(number) > 0).mean() for number in range(frames.count)]
        if np.mean(shares) > OBJECTS.max_masked_share:
            frames.delete_labels()
            return path
        new_path = find_path(None)
        gain = new_path.position_count - path.position_count
        if gain < 0 or not new_path.is_plain or not agrees(new_path):
            if not agrees(path):
                frames.delete_labels()
            return path
        path = new_path
        if not gain:
            break
    return path


def _relabel(frames: PreparedFrames, search: SequenceLabels, path: CameraPath) -> bool:
    """Label the moving objects with a path, and return whether any label changed."""
    poses = _largest_piece_poses(path, frames.count)
    return _set_labels(frames, search.labels(poses, path.camera.pinhole()))


def _set_labels(frames: PreparedFrames, labels: Iterable[np.ndarray]) -> bool:
    """Store the labels of every frame, and return whether any label changed."""
    return any(
        [frames.set_labels(number, frame_labels) for number, frame_labels in enumerate(labels)]
    )


def _largest_piece_poses(path: CameraPath, count: int) -> list[np.ndarray | None]:
    """Return the poses of the largest piece, by frame, (4, 4) each; None in other frames."""
    poses: list[np.ndarray | None] = [None] * count
    if pieces := path.pieces_with_positions:
        largest = max(pieces, key=lambda piece: len(piece.poses))
        for frame, pose in largest.poses.items():
            poses[frame] = pose
    return poses
