"""The pairs of a folder of `tisfm run`, also while the run goes on."""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.folders.run_record import RECORD as RUN
from tisfm.folders.run_record import refuse_other_format
from tisfm.formats import FormatError
from tisfm.formats.reading import read_json
from tisfm.grade import Grade, GradeSummary, summarise_grades
from tisfm.interpretation import Interpretation
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.results.frame import ResultFrame, mean_inverse_depth
from tisfm.results.fused_scene import FusedKind, FusedScene
from tisfm.results.result_frames import Change, as_rgb
from tisfm.rigid import pose_matrix
from tisfm.status import Status

# Without given poses all translations have length 1. A relative difference from 1 above this shows
# that poses were given. A bound on rounding, set by hand.
_MIN_LENGTH_CHANGE = 1e-6


class PairFrames:
    """The first frames of the pairs of a run; a `tisfm.results.result_frames.ResultFrames`.

    Parameters
    ----------
    folder : path
    complete : bool
        Whether to require the ``.npz`` file of every pair. Otherwise pairs without one are left
        out, and the run may still go on.

    Attributes
    ----------
    camera : Camera
        The camera that the run was given, with distortion. Only where `complete` is true.

    Raises
    ------
    FileNotFoundError
        If a file of a pair is missing.
    tisfm.formats.FormatError
        A ValueError: if a file is damaged, or of another format.
    ValueError
        If there is no pair.

    Examples
    --------
    >>> from tisfm.exports import PairFrames
    >>> frames = PairFrames("results")  # a folder of ``tisfm run``
    >>> len(frames), frames.flow(0).shape
    (2, (48, 64, 2))
    """

    # ends of error messages: how to get depth, and how to get depth in another unit
    depth_advice = "run with --motion camera, or look at the statuses in run.json"
    unit_advice = "take the _depth16.png files of the run, which state a scale of their own"
    can_fuse = False
    focal_note = ""  # the statuses of pairs say it

    def __init__(self, folder: str | os.PathLike[str], *, complete: bool = True) -> None:
        self.folder = Path(folder)
        self.camera = Camera()
        self.objects: tuple[MovingObject, ...] = ()
        self.names: Sequence[str] = []
        self._is_complete = complete
        self._record_stamp: tuple[int, int] | None = None  # modification time and size
        self._files: list[tuple[str, Any]] = []
        self._latest_result: tuple[int, Interpretation] | None = None
        self._has_depth_cache: dict[int, bool] = {}
        self.refresh()

    def refresh(self) -> Change | None:
        """Read the record again if it has changed. A run replaces it as a whole."""
        path = self.folder / RUN
        status = os.stat(path)
        stamp = status.st_mtime_ns, status.st_size
        if stamp == self._record_stamp:
            return None
        record = read_json(path)
        refuse_other_format(path, record)
        earlier_files = self._files
        try:
            self._set_record(record)
        except (LookupError, TypeError, AttributeError, ValueError, ArithmeticError) as error:
            reason = " ".join(str(error).split())
            raise FormatError(f"{path} is damaged or of another kind: {reason}") from error
        if self._is_complete:
            self._require_files("npz" in record["outputs"])
        self._record_stamp = stamp
        self._latest_result, self._has_depth_cache = None, {}
        new_files = dict(self._files)
        has_all_earlier_files = all(
            name in new_files and new_files[name] == files for name, files in earlier_files
        )
        return "grown" if has_all_earlier_files else "replaced"

    def __len__(self) -> int:
        return len(self.names)

    @property
    def grade_summary(self) -> GradeSummary:
        """The grades of the frames, the median and the worst."""
        return summarise_grades(self.grades, self.statuses, self.depth_errors)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frames, px."""
        height, width = self.result(0).inverse_depth.shape
        return height, width

    def result(self, number: int) -> Interpretation:
        """Read the interpretation of a pair; the latest one is kept."""
        if self._latest_result is None or self._latest_result[0] != number:
            self._latest_result = None
            self._latest_result = number, Interpretation.load(self._file(self.names[number]))
        return self._latest_result[1]

    def read(self, number: int) -> ResultFrame:
        """Read everything about the first frame of a pair."""
        result = Interpretation.load(self._file(self.names[number]))
        length = self._lengths[number] if self.has_one_scale else 1.0
        motions = {}
        for k, twist in enumerate(() if result.motions is None else result.motions):
            twist = twist * np.repeat((length, 1.0), 3)
            motions[k] = twist, pose_matrix(twist)
        inverse = np.where(result.inverse_depth > 0, result.inverse_depth, np.float32(np.nan))
        scale = 1.0 if self.has_one_scale else mean_inverse_depth(inverse) or 1.0
        return ResultFrame(
            number=number,
            picture=as_rgb(result.frame),
            camera=result.camera,
            inverse_depth=inverse,
            inverse_depth_std=result.inverse_depth_std,
            status=result.status,
            scale=scale,
            confidence=result.confidence,
            labels=result.labels,
            hidden=result.occlusion,
            rho=result.rho,
            stored_flow=result.flow,
            motions=motions,
        )

    def picture(self, number: int) -> NDArray[np.uint8]:
        """Read the first frame of a pair, (H, W) or (H, W, 3) RGB."""
        return self.result(number).frame

    def inverse_depth(self, number: int) -> NDArray[np.float32]:
        """Read the inverse depth of a pair, (H, W)."""
        return self.result(number).inverse_depth

    def has_depth(self, number: int) -> bool:
        """Return whether a pair has depth that its status does not call wrong."""
        if self.statuses[number] in ("diverged", "pose_mismatch"):
            return False
        if number not in self._has_depth_cache:
            self._has_depth_cache[number] = bool((self.result(number).inverse_depth > 0).any())
        return self._has_depth_cache[number]

    def scale(self, number: int) -> tuple[int, float]:
        """Return the group, always 0, and the scale: mean inverse depth, or 1 with given poses."""
        if self.has_one_scale:
            return 0, 1.0
        return 0, mean_inverse_depth(self.inverse_depth(number)) or 1.0

    def flow(self, number: int) -> NDArray[np.float32]:
        """Read the image motion of a pair, (H, W, 2) px."""
        return self.result(number).flow

    def masks(self, number: int) -> dict[str, NDArray[np.bool_]]:
        """Return the mask of pixels visible in the next frame, and a mask of each motion."""
        result = self.result(number)
        masks: dict[str, NDArray[np.bool_]] = {"visible": ~result.occlusion}
        if result.labels is not None and result.settings.motion == "objects":
            count = 0 if result.motions is None else len(result.motions)
            masks |= {f"motion-{label}": result.labels == label for label in range(count)}
        return masks

    def fused(self, kind: FusedKind, number: int) -> FusedScene:
        """Raise ValueError: pairs are not fused."""
        raise InputError("pairs of tisfm run are not fused: use tisfm reconstruct")

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.npz"

    def _set_record(self, record: Any) -> None:
        pairs = sorted(record["pairs"].items(), key=lambda item: item[1]["number"])
        complete_pairs = [
            (name, pair) for name, pair in pairs if self._is_complete or _has_npz(pair)
        ]
        if pairs and not complete_pairs:
            raise InputError("it lists no .npz file: run again with npz among --outputs")
        for name, _ in complete_pairs:
            if os.path.basename(name) != name or not name:
                raise InputError(f"{name!r} is not the name of a pair")
        motion = record["settings"]["motion"]
        if self._is_complete:
            self.camera = _camera_of(record["camera"])
        self.names = [name for name, _ in complete_pairs]
        self._files = [(name, pair.get("files")) for name, pair in complete_pairs]
        self.statuses: Sequence[Status] = [
            Status(pair["status"], pair["message"]) for _, pair in complete_pairs
        ]
        self.grades: Sequence[Grade] = [Grade(pair["grade"]) for _, pair in complete_pairs]
        self.depth_errors: Sequence[float] = [
            math.nan if (error := pair["depth_error"]) is None else float(error)
            for _, pair in complete_pairs
        ]
        self.times: Sequence[float | None] = [
            (pair.get("times") or [None])[0] for _, pair in complete_pairs
        ]
        motions = [_motion_of(pair) for _, pair in complete_pairs]
        numbers = [int(pair["number"]) for _, pair in complete_pairs]
        self._lengths = [1.0 if motion is None else motion[1] for motion in motions]
        self.has_one_scale = motion == "camera" and any(
            abs(length - 1) > _MIN_LENGTH_CHANGE for length in self._lengths
        )
        poses = [None if motion is None else motion[0] for motion in motions]
        self.poses, self.piece = _chain_poses(numbers, poses if self.has_one_scale else [])
        self.unit = (
            "the unit of the poses"
            if self.has_one_scale
            else "lengths of the motion to the next frame"
        )
        self.quantities = ("confidence",) + (("deviation",) if motion != "field" else ())
        self.quantities += ("object",) if motion == "objects" else ()

    def _require_files(self, was_written: bool) -> None:
        """Raise an error if there is no pair, or a pair has no file."""
        if not self.names:
            raise InputError(f"{self.folder} has no complete pair: run again, with --resume")
        names = [name for name in self.names if not self._file(name).is_file()]
        if names:
            reason = "it was removed" if was_written else "--outputs left it out"
            raise FileNotFoundError(
                f"{self.folder} has no {names[0]}.npz, which every export needs: {reason}; run "
                "again with npz among --outputs"
            )


def _has_npz(pair: Any) -> bool:
    """Return whether a pair has its file; records of early versions do not list files."""
    return pair.get("files") is None or ".npz" in pair["files"]


def _camera_of(record: dict[str, Any]) -> Camera:
    center = record["center"]
    return Camera(
        focal=record["focal"],
        center=None if center is None else (center[0], center[1]),
        distortion=record["distortion"],
        aspect=record.get("aspect", 1.0),
        readout=record.get("readout"),
    )


def _motion_of(pair: Any) -> tuple[NDArray[np.float64], float] | None:
    """Return the motion of a pair, (4, 4), and the length of its translation, or None.

    The twist, whose translation has length 1, gives the unit of this length. Only a given pose may
    have another length: its translation has the unit of depth.
    """
    motions, twists = pair.get("motions"), pair.get("twists")
    if not motions or not twists:
        return None
    pose = np.eye(4)
    pose[:3] = np.reshape(np.array(motions[0], float), (3, 4))
    length = float(np.linalg.norm(pose_matrix(twists[0])[:3, 3]))
    return pose, float(np.linalg.norm(pose[:3, 3])) / length if length > 0 else 1.0


def _chain_poses(
    numbers: list[int], motions: list[NDArray[np.float64] | None]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return poses, camera to world, from the motions between neighbouring frames; and pieces.

    A new piece begins where a pair is missing. Without motions every frame is at the origin, in
    a piece of its own, with its own scale.
    """
    count = len(numbers)
    poses, piece = np.tile(np.eye(4), (count, 1, 1)), np.arange(count, dtype=np.int32)
    for k in range(1, count if motions else 0):
        motion = motions[k - 1]
        if numbers[k] == numbers[k - 1] + 1 and motion is not None:
            poses[k] = poses[k - 1] @ np.linalg.inv(motion)
            piece[k] = piece[k - 1]
    return poses, piece
