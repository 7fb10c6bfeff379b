"""The frames of a result, of `tisfm run` or of `tisfm reconstruct`, one as the other."""

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.folders.run_record import RECORD as RUN
from tisfm.folders.run_record import refuse_other_format
from tisfm.formats import FormatError
from tisfm.formats.reading import read_json
from tisfm.interpretation import Interpretation
from tisfm.reconstruction.result.folder import DEPTH, depth_path
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.rigid import rigid_motion
from tisfm.status import STATUSES, Status

_SAME_LENGTH = 1e-6  # relative


class ResultFrames(Protocol):
    """Frames with depth and what else a result has of them, read when they are asked for.

    Attributes
    ----------
    folder : Path
        Where they lie.
    names : tuple of str
        One for each, none twice.
    times : tuple of float or None
        s.
    shape : (int, int)
        Height and width, px.
    advice : str
        What to do where there is no depth.
    unit_advice : str
        What to do where depth does not fit into a file, in its unit.
    is_posed : bool
        Whether depth has the unit of poses, and not each frame one of its own.
    """

    folder: Path
    names: tuple[str, ...]
    times: tuple[float | None, ...]
    shape: tuple[int, int]
    advice: str
    unit_advice: str
    is_posed: bool

    def __len__(self) -> int:
        """Return how many there are."""

    def has_depth(self, frame: int) -> bool:
        """Return whether there is depth of a frame."""

    def unknown_status(self, frame: int) -> str:
        """Return the status code of a frame if this version does not know it, else ""."""

    def picture(self, frame: int) -> np.ndarray:
        """Return a frame, (H, W) or (H, W, 3) RGB uint8."""

    def inverse_depth(self, frame: int) -> np.ndarray:
        """Return its inverse depth, (H, W) float32; there is none where it is not above 0."""

    def scale(self, frame: int) -> tuple[int, float]:
        """Return the group of frames whose scale is one, and what inverse depth is divided by."""

    def flow(self, frame: int) -> np.ndarray:
        """Return the image motion to the next frame, (H, W, 2) float32, or raise ValueError."""

    def masks(self, frame: int) -> dict[str, np.ndarray]:
        """Return what may be told apart in it, (H, W) bool, by names; or raise ValueError."""


class SequenceFrames:
    """The frames of a reconstruction.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import SequenceFrames
    >>> frames = SequenceFrames(tisfm.Reconstruction.load("walk"))
    >>> len(frames), frames.has_depth(0), frames.inverse_depth(0).shape
    (9, True, (180, 240))
    """

    unit_advice = "give another unit by --scale"
    is_posed = True

    def __init__(self, result: Reconstruction) -> None:
        self._result = result
        self.folder, self.times, self.shape = result.folder, result.times, result.shape
        self.names = distinct(result.names)
        self.advice = "reconstruct with --depth-of all"
        if not (result.piece >= 0).any():
            self.advice = "none has a pose either; the statuses of the reconstruction say why"
        elif not (self.folder / DEPTH).is_dir():
            self.advice = f"its folder {DEPTH} is gone"

    def __len__(self) -> int:
        return len(self._result)

    def has_depth(self, frame: int) -> bool:
        """Return whether there is depth of a frame, in a scale that is known."""
        return bool(self._result.piece[frame] >= 0) and depth_path(self.folder, frame).exists()

    def unknown_status(self, frame: int) -> str:
        """Return the status code of a frame if this version does not know it, else ""."""
        status = self._result.status[frame]
        return "" if status in STATUSES else str(status)

    def picture(self, frame: int) -> np.ndarray:
        """Return a frame without distortion, (H, W) or (H, W, 3) RGB uint8."""
        return self._result.picture(frame)

    def inverse_depth(self, frame: int) -> np.ndarray:
        """Return its inverse depth, (H, W) float32."""
        return self._result.inverse_depth(frame)

    def scale(self, frame: int) -> tuple[int, float]:
        """Return its piece, all of which has one scale."""
        return int(self._result.piece[frame]), 1.0

    def flow(self, frame: int) -> np.ndarray:
        """Raise ValueError: a reconstruction keeps none."""
        raise InputError(
            f"{self.folder} is of tisfm reconstruct, which keeps no image motion: export what "
            "`tisfm run` makes of the same frames"
        )

    def masks(self, frame: int) -> dict[str, np.ndarray]:
        """Return what is at rest, and each thing that moves on its own."""
        things = self._result.objects
        if self._result.settings.motion != "objects":
            raise InputError(
                f"{self.folder} has no labels of what moves: reconstruct with --motion objects"
            )
        labels = self._result.labels(frame)
        found = {f"object-{thing.id}": labels == thing.id for thing in things}
        return {"at-rest": labels == 0, **found}


class PairFrames:
    """The first frames of the pairs that `tisfm run` interpreted.

    Parameters
    ----------
    folder : path

    Attributes
    ----------
    camera : Camera
        As it was stated, with distortion.

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
    >>> frames = PairFrames("results")  # what ``tisfm run`` wrote
    >>> len(frames), frames.flow(0).shape
    (2, (48, 64, 2))
    """

    advice = "run with --motion camera, or look at the statuses in run.json"
    unit_advice = "take the _depth16.png files of the run, which state a scale of their own"

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = folder = Path(folder)
        record = read_json(folder / RUN)
        refuse_other_format(folder / RUN, record)
        try:
            pairs = sorted(record["pairs"].items(), key=lambda item: item[1]["number"])
            self.names = tuple(_checked(name) for name, _ in pairs)
            self.times = tuple((pair.get("times") or (None,))[0] for _, pair in pairs)
            self._statuses = [Status(pair["status"]) for _, pair in pairs]
            self.is_posed = any(_is_posed(pair) for _, pair in pairs)
            self.camera = _camera_of(record["camera"])
            is_kept = "npz" in record["outputs"]
        except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
            reason = " ".join(str(error).split())
            raise FormatError(f"{folder / RUN} is damaged or of another kind: {reason}") from error
        if not self.names:
            raise InputError(f"{folder} has no pair that is complete: run again, with --resume")
        missing = [name for name in self.names if not self._file(name).is_file()]
        if missing:
            what = "was removed" if is_kept else "was left out by --outputs"
            raise FileNotFoundError(
                f"{folder} has no {missing[0]}.npz, which {what}, and of which everything is "
                "exported: run again with npz among --outputs"
            )
        self._read: tuple[int, Interpretation] | None = None
        self._shows_depth: dict[int, bool] = {}
        self.shape = self.result(0).flow.shape[:2]

    def __len__(self) -> int:
        return len(self.names)

    def result(self, frame: int) -> Interpretation:
        """Return a pair; the last one is kept."""
        if self._read is None or self._read[0] != frame:
            self._read = None
            self._read = frame, Interpretation.load(self._file(self.names[frame]))
        return self._read[1]

    def has_depth(self, frame: int) -> bool:
        """Return whether a pair shows depth that may be believed."""
        if self._statuses[frame] in ("diverged", "pose_mismatch"):
            return False
        if frame not in self._shows_depth:
            self._shows_depth[frame] = bool((self.result(frame).inverse_depth > 0).any())
        return self._shows_depth[frame]

    def unknown_status(self, frame: int) -> str:
        """Return the status code of a pair if this version does not know it, else ""."""
        status = self._statuses[frame]
        return "" if status in STATUSES else str(status)

    def picture(self, frame: int) -> np.ndarray:
        """Return the first frame of a pair, (H, W) or (H, W, 3) RGB uint8."""
        return self.result(frame).frame

    def inverse_depth(self, frame: int) -> np.ndarray:
        """Return its inverse depth, (H, W) float32."""
        return self.result(frame).inverse_depth

    def scale(self, frame: int) -> tuple[int, float]:
        """Return the mean inverse depth: each pair has a scale of its own, without poses."""
        if self.is_posed:
            return 0, 1.0
        mean = np.maximum(self.inverse_depth(frame), 0).mean(dtype=np.float64)
        return 0, float(mean) or 1.0

    def flow(self, frame: int) -> np.ndarray:
        """Return the image motion, (H, W, 2) float32."""
        return self.result(frame).flow

    def masks(self, frame: int) -> dict[str, np.ndarray]:
        """Return what is visible in the next frame, and what has each of several motions."""
        result = self.result(frame)
        found = {"visible": ~result.occlusion}
        if result.labels is not None and result.settings.motion == "objects":
            count = 0 if result.motions is None else len(result.motions)
            found |= {f"motion-{label}": result.labels == label for label in range(count)}
        return found

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.npz"


def distinct(names: Sequence[str]) -> tuple[str, ...]:
    """Return names of files, none twice, also where letters of both cases are the same."""
    plain = [Path(name).name for name in names]
    count = Counter(name.casefold() for name in plain)
    if all(plain) and max(count.values(), default=1) == 1:
        return tuple(plain)
    return tuple(f"{number:06d}" for number in range(len(names)))


def _checked(name: str) -> str:
    """Return the name of a pair, or raise ValueError if it leads out of its folder."""
    if os.path.basename(name) != name or not name:
        raise InputError(f"{name!r} is not the name of a pair")
    return name


def _camera_of(record: dict[str, Any]) -> Camera:
    center = record["center"]
    return Camera(
        focal=record["focal"],
        center=None if center is None else (center[0], center[1]),
        distortion=record["distortion"],
        aspect=record.get("aspect", 1.0),
        readout=record.get("readout"),
    )


def _is_posed(pair: dict[str, Any]) -> bool:
    """Return whether a pair was given its pose: its motion then has a length of its own."""
    motions, twists = pair.get("motions"), pair.get("twists")
    if not motions or not twists:
        return False
    given = np.reshape(np.array(motions[0], float), (3, 4))[:, 3]
    found = rigid_motion(np.array(twists[0], float))[1]
    return not np.allclose(given, found, rtol=0, atol=_SAME_LENGTH * max(1, np.abs(found).max()))
