"""The request of an export: result, chosen frames, their pieces, times and rate, and options."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import index
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.camera_file import FILE_NAME as CAMERA_FILE
from tisfm.camera_file import read_camera, read_camera_record
from tisfm.errors import InputError, OutOfRangeError
from tisfm.folders.result_folder import make_subfolder
from tisfm.fusion.agreement import Coverage
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.results.pair_frames import PairFrames
from tisfm.results.sequence_frames import SequenceFrames
from tisfm.trajectory.times import are_increasing, times_or_numbers


def select_frames(frames: Iterable[int] | None, count: int) -> list[int]:
    """Return the numbers of the frames to export in ascending order, by default all.

    Raises IndexError if a frame does not exist.

    Raises ValueError if no frame is chosen.
    """
    chosen = sorted({index(frame) for frame in (range(count) if frames is None else frames)})
    if not chosen:
        raise InputError(f"no frame is chosen of {count}: expected some, from 0 to {count - 1}")
    for frame in (chosen[0], chosen[-1]):
        if not 0 <= frame < count:
            raise OutOfRangeError(f"frame is {frame}: expected 0 to {count - 1}")
    return chosen


def piece_frames(result: Reconstruction, frames: Iterable[int] | None = None) -> list[list[int]]:
    """Return the frames with a pose of each piece, the largest piece first.

    Pieces in which the camera only turns come last.

    Raises IndexError if a frame does not exist.

    Raises ValueError if none of the frames has a pose.
    """
    chosen = select_frames(frames, len(result))
    pieces: dict[int, list[int]] = {}
    for frame in chosen:
        if result.piece[frame] >= 0 and np.isfinite(result.poses[frame]).all():
            pieces.setdefault(int(result.piece[frame]), []).append(frame)
    if not pieces:
        raise InputError(
            f"none of {len(chosen)} frames in {result.folder} has a pose: see the statuses of "
            "the reconstruction"
        )
    return sorted(
        pieces.values(),
        key=lambda frames: (not result.only_turns(int(result.piece[frames[0]])), len(frames)),
        reverse=True,
    )


def piece_files(folder: Path, name: str, pieces: Sequence[object]) -> list[Path]:
    """Return a file for each piece: the first has the name, the others also have a number."""
    stem, dot, suffix = name.partition(".")
    return [
        folder / (name if number == 1 else f"{stem}-piece{number}{dot}{suffix}")
        for number in range(1, len(pieces) + 1)
    ]


DEFAULT_FRAME_RATE = 25.0  # frames/s, for frames without times: the rate of PAL video
# frames/s, bounds set by hand
_MIN_RATE = 0.01
_MAX_RATE = 1000.0


def frame_times(
    times: Sequence[float | None],  # times of all frames of a sequence
    frames_per_second: float | None = None,  # replaces `times` by evenly spaced times from 0
) -> NDArray[np.float64]:
    """Return the times of frames, s, or their numbers if times are unknown.

    Raises ValueError if `frames_per_second` is out of range.
    """
    if frames_per_second is not None:
        return np.arange(len(times)) / check_rate(frames_per_second)
    return times_or_numbers(times)


def frame_rate(
    times: Sequence[float | None], frames: Sequence[int], frames_per_second: float | None = None
) -> float:
    """Return the rate of frames, 1/s.

    By default it is one over the median time between neighbours, or 25 if times are unknown.

    Raises ValueError if `frames_per_second` is out of range.
    """
    if frames_per_second is not None:
        return check_rate(frames_per_second)
    selected_times = [times[frame] for frame in frames]
    if len(selected_times) < 2 or not are_increasing(selected_times):
        return DEFAULT_FRAME_RATE
    period = float(np.median(np.diff(np.array(selected_times, float))))
    return float(np.clip(1 / period, _MIN_RATE, _MAX_RATE))


def check_rate(frames_per_second: float) -> float:
    """Return a frame rate; raise ValueError if it is out of range."""
    if not _MIN_RATE <= frames_per_second <= _MAX_RATE:
        raise InputError(
            f"frames_per_second is {frames_per_second}: expected {_MIN_RATE:g} to {_MAX_RATE:g}"
        )
    return float(frames_per_second)


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """The result and the frames to export, and the options of the formats."""

    result: Reconstruction | None  # None for a folder of `tisfm run`
    frames: SequenceFrames | PairFrames
    chosen: Sequence[int]  # numbers of the frames to export
    folder: Path  # folder of the exported files; it exists
    frames_per_second: float | None = None
    # disparity of anaglyphs and of the swinging camera, as a share of the width
    disparity: float | None = None
    # screen, screen_depth: the plane of the screen of anaglyphs and of the swinging camera, as a
    # quantile of the depth or as a depth
    screen: float | None = None
    screen_depth: float | None = None
    # how much of the surface points and meshes keep
    coverage: Coverage = "normal"

    @property
    def sequence(self) -> Reconstruction:
        """The reconstruction; raises ValueError for a folder of pairs."""
        if self.result is None:
            raise InputError(
                f"{self.frames.folder} is a run, whose pairs have no common scale and no path: "
                "export the result of tisfm reconstruct for the same frames"
            )
        return self.result

    def subfolder(self, name: str) -> Path:
        """Return a folder inside the folder of the export; make it if it does not exist."""
        return make_subfolder(self.folder / name)


def source_camera(export: ExportRequest) -> tuple[Camera, tuple[int, int]]:
    """Return the camera with distortion, and height and width of its frames, px.

    For a reconstruction these are the frames of the source, before cropping and shrinking.

    Raises FileNotFoundError if the reconstruction has no camera file.
    """
    if isinstance(export.frames, PairFrames):
        return export.frames.camera, export.frames.shape
    file = export.frames.folder / CAMERA_FILE
    if not file.is_file():
        raise FileNotFoundError(
            f"{export.frames.folder} has no {CAMERA_FILE}, so the lens of the frames is unknown: "
            "run tisfm reconstruct again"
        )
    record = read_camera_record(file)
    return read_camera(file), (int(record["height"]), int(record["width"]))
