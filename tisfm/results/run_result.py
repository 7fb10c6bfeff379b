"""The folder of `tisfm run`, also while the run goes on."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.folders.run_record import RECORD, refuse_other_format
from tisfm.formats import FormatError
from tisfm.formats.reading import read_json
from tisfm.interpretation import Interpretation
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.results.frame import ViewFrame
from tisfm.results.fused_scene import Whole, WholeKind
from tisfm.results.result import Change, as_rgb
from tisfm.rigid import pose_matrix
from tisfm.status import Status

_UNIT_LENGTH = 1e-6  # of translations whose length says nothing of the scale


class RunResult:
    """The pairs that a run has finished; see `tisfm.results.result.Result`.

    Raises
    ------
    FormatError
        If the record is damaged or of another format, or the run keeps no ``.npz`` files.
    OSError
        If it cannot be read.
    """

    has_whole = False

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.objects: tuple[MovingObject, ...] = ()
        self.names: list[str] = []
        self._seen: tuple[int, int] | None = None
        self._files: list[Any] = []
        self.refresh()

    def refresh(self) -> Change | None:
        """Read the record anew if it is another; it is replaced as a whole while a run goes on."""
        path = self.folder / RECORD
        about = os.stat(path)
        seen = about.st_mtime_ns, about.st_size
        if seen == self._seen:
            return None
        record = read_json(path)
        refuse_other_format(path, record)
        before = self._files
        try:
            self._take(record)
        except (LookupError, TypeError, AttributeError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise FormatError(f"{path} is damaged or of another kind: {reason}") from error
        self._seen = seen
        now = dict(self._files)
        is_kept = all(name in now and now[name] == files for name, files in before)
        return "grown" if is_kept else "replaced"

    def read(self, number: int) -> ViewFrame:
        """Read the interpretation of a pair."""
        result = Interpretation.load(self.folder / f"{self.names[number]}.npz")
        motions = {}
        for k, twist in enumerate(() if result.motions is None else result.motions):
            twist = twist * np.repeat(
                (self._lengths[number] if self.has_one_scale else 1.0, 1.0), 3
            )
            motions[k] = twist, pose_matrix(twist)
        inverse = np.where(result.inverse_depth > 0, result.inverse_depth, np.float32(np.nan))
        scale = 1.0
        if not self.has_one_scale and np.isfinite(inverse).any():
            scale = float(np.nanmean(inverse, dtype=np.float64))
        return ViewFrame(
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
        """Read the picture of a pair's first frame."""
        return self.read(number).picture

    def whole(self, kind: WholeKind, number: int) -> Whole:
        """Raise ValueError: pairs are not fused."""
        raise InputError("pairs of tisfm run are not shown together: see tisfm reconstruct")

    def _take(self, record: Any) -> None:
        """Take over what a record says."""
        pairs = sorted(record["pairs"].items(), key=lambda item: item[1]["number"])
        kept = [(name, pair) for name, pair in pairs if _has_npz(pair)]
        if pairs and not kept:
            raise InputError("it has no .npz of any pair: run again with npz among --outputs")
        for name, _ in kept:
            if os.path.basename(name) != name:
                raise InputError(f"{name} is not the name of a pair")
        motion = record["settings"]["motion"]
        self.names = [name for name, _ in kept]
        self._files = [(name, pair.get("files")) for name, pair in kept]
        self.statuses = [Status(pair["status"], pair["message"]) for _, pair in kept]
        self.times = [(pair.get("times") or [None])[0] for _, pair in kept]
        found = [_motion_of(pair) for _, pair in kept]
        numbers = [int(pair["number"]) for _, pair in kept]
        self._lengths = [1.0 if one is None else one[1] for one in found]
        self.has_one_scale = motion == "camera" and any(
            abs(length - 1) > _UNIT_LENGTH for length in self._lengths
        )
        poses = [None if one is None else one[0] for one in found]
        self.poses, self.piece = _chained(numbers, poses if self.has_one_scale else [])
        self.unit = (
            "the unit of the poses"
            if self.has_one_scale
            else "lengths of the motion to the next frame"
        )
        self.quantities = ("confidence",) + (("deviation",) if motion != "field" else ())
        self.quantities += ("object",) if motion == "objects" else ()


def _has_npz(pair: Any) -> bool:
    """Return whether a pair is kept; records of early versions do not say so."""
    return pair.get("files") is None or ".npz" in pair["files"]


def _motion_of(pair: Any) -> tuple[NDArray[np.float64], float] | None:
    """Return the motion of a pair, (4, 4), and its length over that of the twist, which is 1.

    Where poses were given they say the length, which is that of the unit of the depth.
    """
    motions, twists = pair.get("motions"), pair.get("twists")
    if not motions or not twists:
        return None
    pose = np.eye(4)
    pose[:3] = np.reshape(np.array(motions[0], float), (3, 4))
    length = float(np.linalg.norm(pose_matrix(twists[0])[:3, 3]))
    return pose, float(np.linalg.norm(pose[:3, 3])) / length if length > 0 else 1.0


def _chained(
    numbers: list[int], motions: list[NDArray[np.float64] | None]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the poses of frames, camera to world, from the motions between neighbours.

    A new piece begins where a pair is missing. Without motions every frame is at the origin, in
    a piece of its own, whose scale is its own.
    """
    count = len(numbers)
    poses, piece = np.tile(np.eye(4), (count, 1, 1)), np.arange(count, dtype=np.int32)
    for k in range(1, count if motions else 0):
        before = motions[k - 1]
        if numbers[k] == numbers[k - 1] + 1 and before is not None:
            poses[k] = poses[k - 1] @ np.linalg.inv(before)
            piece[k] = piece[k - 1]
    return poses, piece
