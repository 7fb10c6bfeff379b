"""Frames in, interpretations out, two frames in memory at a time."""

import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera
from tisfm.interpretation import Interpretation
from tisfm.settings import Settings

Source = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Iterable[npt.ArrayLike]


@dataclass(frozen=True, kw_only=True)
class FramePair:
    """Two consecutive frames of a source, with their names (file stems, or frame numbers)."""

    name0: str
    name1: str
    frame0: np.ndarray
    frame1: np.ndarray

    def interpret(
        self, *, camera: Camera | None = None, settings: Settings | None = None
    ) -> Interpretation:
        """Interpret the pair; errors name its frames."""
        from tisfm.pair import interpret

        try:
            return interpret(self.frame0, self.frame1, camera=camera, settings=settings)
        except (TypeError, ValueError) as error:
            raise type(error)(f"frames {self.name0} and {self.name1}: {error}") from error


class FrameSource:
    """A source of frames, checked when it is made and read as it is iterated.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A folder of images (in natural order of their names), a glob pattern, a video file, a
        list of image files, or any iterable of (H, W) or (H, W, 3) arrays.
    step : int
        Take every `step`-th frame.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a pattern matches nothing.
    ValueError
        If there is only one frame, or none.
    """

    def __init__(self, source: Source, *, step: int = 1) -> None:
        if isinstance(step, bool) or not isinstance(step, int) or step < 1:
            raise ValueError(f"step is {step!r}: expected a positive integer")
        self.step = step
        self.title = "frames"
        self._count: int | None = None
        self._frames: Iterable[tuple[str, np.ndarray]]
        if isinstance(source, (str, os.PathLike)):
            self.title = os.fspath(source)
            self._open_path(os.fspath(source))
        else:
            if isinstance(source, Sequence) and source and _all_paths(source):
                self._use_files([Path(os.fspath(item)) for item in source])
            else:
                self._use_arrays(source)

    def __len__(self) -> int:
        """Return the number of pairs, where it is known beforehand; TypeError where not."""
        if self._count is None:
            raise TypeError(f"the length of {self.title} is not known before it is read")
        return max(0, -(-self._count // self.step) - 1)

    def __iter__(self) -> Iterator[FramePair]:
        """Read the frames, and yield every pair of consecutive ones."""
        previous: tuple[str, np.ndarray] | None = None
        pairs = 0
        for name, frame in islice(self._frames, 0, None, self.step):
            if previous is not None:
                yield FramePair(
                    name0=previous[0], frame0=previous[1], name1=name, frame1=frame
                )
                pairs += 1
            previous = name, frame
        if pairs == 0:
            raise ValueError(f"{self.title} ended before there was a pair: expected more frames")

    def _open_path(self, source: str) -> None:
        from tisfm.formats import IMAGE_SUFFIXES

        if os.path.isdir(source):
            files = [f for f in Path(source).iterdir() if f.suffix.lower() in IMAGE_SUFFIXES]
            if not files:
                raise FileNotFoundError(
                    f"the folder {source} has no images: expected files ending in "
                    f"{', '.join(IMAGE_SUFFIXES)}"
                )
            self._use_files(sorted(files, key=_natural))
        elif os.path.isfile(source):
            if source.lower().endswith(IMAGE_SUFFIXES):
                self._use_files([Path(source)])
            else:
                self._use_video(source)
        elif glob.has_magic(source):
            files = [f for f in map(Path, glob.glob(source)) if f.is_file()]
            if not files:
                raise FileNotFoundError(f"no file matches {source}: check the pattern")
            self._use_files(sorted(files, key=_natural))
        else:
            raise FileNotFoundError(f"there is no file or folder {source}: check the path")

    def _use_files(self, files: list[Path]) -> None:
        for file in files:
            if not file.exists():
                raise FileNotFoundError(f"there is no file {file}: check the path")
        self._check_count(len(files))
        stems = [file.stem for file in files]
        if len(set(stems)) < len(stems):  # of different folders or suffixes
            stems = [f"{index:06d}_{stem}" for index, stem in enumerate(stems)]
        self._frames = _ImageFiles(files, stems)

    def _use_video(self, path: str) -> None:
        video = _Video(path)
        if video.announced is not None:
            self._check_count(video.announced)
        self._frames = video

    def _use_arrays(self, items: Iterable[Any]) -> None:
        if isinstance(items, (Sequence, np.ndarray)):
            self._check_count(len(items))
        self._frames = ((f"frame_{k:06d}", np.asarray(item)) for k, item in enumerate(items))

    def _check_count(self, count: int) -> None:
        if count < self.step + 1:
            raise ValueError(
                f"{self.title} has {count} frame{'s' * (count != 1)}: expected at least "
                f"{self.step + 1}, to make a pair"
            )
        self._count = count


def interpret_sequence(
    source: Source,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    step: int = 1,
) -> Iterator[Interpretation]:
    """Interpret every pair of consecutive frames, one at a time.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A folder of images, a glob pattern, a video, a list of image files, or any iterable of
        frames. Two frames are in memory at a time.
    camera, settings
        As for `tisfm.interpret`.
    step : int
        Take every `step`-th frame, for slow motion.

    Returns
    -------
    iterator of Interpretation
        For frames (0, 1), (1, 2), …

    Raises
    ------
    FileNotFoundError, ValueError
        At once if the source does not exist or has fewer than two frames; while iterating if a
        frame cannot be read, or as `tisfm.interpret`, with the names of the frames.
    """
    pairs = FrameSource(source, step=step)
    return (pair.interpret(camera=camera, settings=settings) for pair in pairs)


class _ImageFiles:
    """Image files, read one after the other."""

    def __init__(self, files: list[Path], names: list[str]) -> None:
        self._files, self._names = files, names

    def __iter__(self) -> Iterator[tuple[str, np.ndarray]]:
        from tisfm.formats import read_image

        for name, file in zip(self._names, self._files, strict=True):
            yield name, read_image(file)


class _Video:
    """A video file, decoded one frame after the other.

    Attributes
    ----------
    announced : int or None
        The number of frames that the file states, if it does.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        capture = cv2.VideoCapture(self._path)
        try:
            readable = capture.isOpened() and capture.grab()
            self.announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if readable else None
        finally:
            capture.release()
        if not readable:
            raise ValueError(
                f"{path} is not an image or a video that OpenCV can read: it is damaged or of an "
                "unknown format; convert it, for instance to MP4"
            )
        if self.announced is not None and self.announced < 1:
            self.announced = None

    def __iter__(self) -> Iterator[tuple[str, np.ndarray]]:
        capture = cv2.VideoCapture(self._path)
        stem = Path(self._path).stem
        index = 0
        try:
            while True:
                read, frame = capture.read()
                if not read:
                    break
                yield f"{stem}_{index:06d}", np.ascontiguousarray(frame[..., ::-1])
                index += 1
        finally:
            capture.release()
        # Containers miscount by a frame or two; more means that the file is cut off.
        if self.announced is not None and index < self.announced - max(2, self.announced // 50):
            raise ValueError(
                f"{self._path} ends after {index} of {self.announced} frames: the file is cut "
                "off or damaged; the results up to there are complete"
            )


def _all_paths(items: Sequence[Any]) -> bool:
    return all(isinstance(item, (str, os.PathLike)) for item in items)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort key by which frame2 comes before frame10."""
    parts = re.split(r"(\d+)", str(path))
    return [(1, int(p), "") if p.isdigit() else (0, 0, p) for p in parts]
