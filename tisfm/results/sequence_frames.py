"""The frames of a reconstruction, in memory or in the folder of `tisfm reconstruct`."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.grade import Grade, GradeSummary
from tisfm.reconstruction.result.folder import DEPTH, RECORD, depth_path, has_labels
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.results.frame import ResultFrame
from tisfm.results.fused_scene import FusedKind, FusedScene, fuse_keyframes, limit_size, read_fused
from tisfm.results.result_frames import Change, as_rgb
from tisfm.rigid import rigid_twist
from tisfm.status import Status


class SequenceFrames:
    """The frames of a reconstruction; a `tisfm.results.result_frames.ResultFrames`.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import SequenceFrames
    >>> frames = SequenceFrames(tisfm.Reconstruction.load("walk"))
    >>> len(frames), frames.has_depth(0), frames.inverse_depth(0).shape
    (9, True, (180, 240))
    """

    unit = "the unit of the path"
    unit_advice = "give another unit by --scale"
    has_one_scale = can_fuse = True

    def __init__(self, result: Reconstruction) -> None:
        self._record_stamp: tuple[int, int] | None = None  # modification time and size
        self._set_result(result)

    @classmethod
    def open(cls, folder: Path) -> "SequenceFrames":
        """Open a folder, which `refresh` reads again when it is replaced.

        Raises
        ------
        FileNotFoundError
            If the folder is not complete.
        tisfm.formats.FormatError
            If a file is damaged.
        """
        try:
            stamp = _stamp(folder)
        except FileNotFoundError:
            raise FileNotFoundError(
                f"the folder {folder} is not complete: it has no {RECORD}"
            ) from None
        frames = cls(Reconstruction.load(folder))
        frames._record_stamp = stamp
        return frames

    def refresh(self) -> Change | None:
        """Read the reconstruction again if it was replaced; keep it while it is being replaced."""
        try:
            stamp = _stamp(self.folder)
        except FileNotFoundError:
            return None
        if stamp == self._record_stamp:
            return None
        self._set_result(Reconstruction.load(self.folder))
        self._record_stamp = stamp
        return "replaced"

    def __len__(self) -> int:
        return len(self.names)

    @property
    def grade_summary(self) -> GradeSummary:
        """The grades of the frames, the median and the worst."""
        return self._result.grade_summary

    @property
    def focal_note(self) -> str:
        """What depends on a stated focal length that the image motion does not show."""
        return self._result.focal_note

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frames, px."""
        return self._result.shape

    @property
    def depth_advice(self) -> str:
        """How to get depth for frames without depth."""
        if not (self.piece >= 0).any():
            return "no frame has a pose; the statuses of the reconstruction say why"
        if not self._result.has_position.any():
            return "the camera only turns: move it sideways"
        if not (self.folder / DEPTH).is_dir():
            return f"its folder {DEPTH} was removed"
        return "reconstruct with --depth-of all"

    def read(self, number: int) -> ResultFrame:
        """Read everything about a frame."""
        result = self._result
        return ResultFrame(
            number=number,
            picture=as_rgb(self.picture(number)),
            camera=result.camera,
            inverse_depth=result.inverse_depth(number),
            inverse_depth_std=result.inverse_depth_std(number),
            status=result.status[number],
            labels=result.labels(number) if self._has_labels else None,
            motions=self._motions(number),
        )

    def picture(self, number: int) -> NDArray[np.uint8]:
        """Read the picture of a frame, without distortion, (H, W) or (H, W, 3) RGB."""
        return self._result.picture(number)

    def inverse_depth(self, number: int) -> NDArray[np.float32]:
        """Read the inverse depth of a frame, (H, W)."""
        return self._result.inverse_depth(number)

    def has_depth(self, number: int) -> bool:
        """Return whether a frame has depth in a known scale."""
        return bool(self.piece[number] >= 0) and depth_path(self.folder, number).exists()

    def scale(self, number: int) -> tuple[int, float]:
        """Return the piece of a frame and 1: all its frames have one scale."""
        return int(self.piece[number]), 1.0

    def flow(self, number: int) -> NDArray[np.float32]:
        """Raise ValueError: a reconstruction keeps no image motion."""
        raise InputError(
            f"{self.folder} is a reconstruction, which has no image motion: export the results of "
            "tisfm run for the same frames"
        )

    def masks(self, number: int) -> dict[str, NDArray[np.bool_]]:
        """Return the mask of the static scene, and of every moving object."""
        if not self._has_labels:
            raise InputError(
                f"{self.folder} has no labels of moving objects, and no masked pixels that move: "
                "reconstruct with --motion objects"
            )
        labels = self._result.labels(number)
        moving = {
            f"object-{moving_object.id}": labels == moving_object.id
            for moving_object in self.objects
        }
        return {"at-rest": labels == 0, **moving}

    def fused(self, kind: FusedKind, number: int) -> FusedScene:
        """Return the stored scene of the largest piece, or fuse the keyframes around a frame.

        Its points are thinned for browsers.
        """
        result, stored_scene = self._result, None
        if self.piece[number] == result.largest_piece:
            stored_scene = read_fused(self.folder, kind)
        return limit_size(
            fuse_keyframes(result, kind, number) if stored_scene is None else stored_scene
        )

    def _set_result(self, result: Reconstruction) -> None:
        self._result, self.folder = result, result.folder
        self.names: Sequence[str] = list(result.names)
        self.statuses: Sequence[Status] = list(result.status)
        self.grades: Sequence[Grade] = list(result.grades)
        self.depth_errors: Sequence[float] = result.depth_error.tolist()
        self.times: Sequence[float | None] = list(result.times)
        self.objects = result.objects
        self.poses, self.piece = result.poses, result.piece
        self.quantities: tuple[str, ...] = ("deviation",)
        # Under "camera", labels are pixels that move on their own and are masked.
        self._has_labels = result.settings.motion == "objects" or has_labels(self.folder)
        self.quantities += ("object",) if self._has_labels else ()

    def _motions(self, number: int) -> dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Return motions relative to the camera until the next frame, by label; 0 is the scene.

        It is empty if the two frames are of different pieces.
        """
        next_number = number + 1
        if next_number >= len(self.names) or not 0 <= self.piece[number] == self.piece[next_number]:
            return {}
        to_next = np.linalg.inv(self.poses[next_number])
        motions = {0: to_next @ self.poses[number]}
        for moving_object in self.objects:
            world_motion = _motion_in_world(moving_object, number)
            if world_motion is not None:
                motions[moving_object.id] = to_next @ world_motion @ self.poses[number]
        return {
            label: (rigid_twist(motion[:3, :3], motion[:3, 3]), motion)
            for label, motion in motions.items()
        }


def _stamp(folder: Path) -> tuple[int, int]:
    """Return modification time and size of the record."""
    file_status = os.stat(folder / RECORD)
    return file_status.st_mtime_ns, file_status.st_size


def _motion_in_world(moving_object: MovingObject, number: int) -> NDArray[np.float64] | None:
    """Return the motion of an object in the world to the next frame, (4, 4), if it is known."""
    if number not in moving_object.frames or number + 1 not in moving_object.frames:
        return None
    pose, next_pose = (
        moving_object.poses[moving_object.frames.index(k)] for k in (number, number + 1)
    )
    if not (np.isfinite(pose).all() and np.isfinite(next_pose).all()):
        return None
    motion: NDArray[np.float64] = next_pose @ np.linalg.inv(pose)
    return motion
