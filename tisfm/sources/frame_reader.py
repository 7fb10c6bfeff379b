"""The protocol of frame readers, the frames that they yield, and warnings about a source."""

import hashlib
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import RunError
from tisfm.formats import FormatError


@dataclass(frozen=True, kw_only=True, eq=False)
class RawFrame:
    """A frame as it was read: its number in the source, its name, and its time, s, if known."""

    index: int
    name: str
    image: np.ndarray
    time: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class BadFrame:
    """A damaged frame: its number in the source, its name, and the error of reading it."""

    index: int
    name: str
    error: FormatError


@dataclass(frozen=True, kw_only=True, eq=False)
class SourceFrame:
    """A frame of a source."""

    index: int  # number in the source, from 0; skipped frames count
    # stem of the image file; else the stem of the video, ``frame`` or ``webcam``, with the number
    name: str
    # seconds since the first frame of a video or webcam, or the time in the file name
    time: float | None
    # (H, W) or (H, W, 3) array: the frame, cropped and shrunk if the source does so
    image: np.ndarray
    # (H, W) bool array, or None: true where pixels are ignored; None if the frame has no such
    # pixels
    ignored: NDArray[np.bool_] | None = None
    # (H, W) uint8 array, or None: given number of the moving object at each pixel, 0 for the
    # background at rest; None if the frame has no given labels
    labels: NDArray[np.uint8] | None = None
    # Whether the values of a float frame may be from 0 to 1, to be stretched to 0 to 255. False
    # once a frame of the source had larger values: then all of its frames are on the 8-bit scale.
    scales_unit_range: bool = True
    # height and width before cropping and shrinking, px; None if the frame is
    # unchanged
    full_shape: tuple[int, int] | None = None


class FrameReader(Protocol):
    """Reads the frames of one kind of source."""

    title: str  # name of the source in messages
    files: tuple[Path, ...]  # all files with frames
    names: tuple[str, ...] | None  # names of all frames if each frame has a file, else None
    prefix: str  # prefix of the names of numbered frames
    count: int | None  # number of frames, if it is known before reading
    announced: int | None  # number of frames that a video states; it may be wrong by a few
    times: tuple[float, ...] | None  # times of all frames, s, if they are known before reading
    notes: tuple[str, ...]  # notes to the user on how the source is read
    ahead: bool  # whether frames may be read ahead in a thread

    def read(self, chosen: slice) -> Iterator[RawFrame | BadFrame]:
        """Read the frames with these numbers (start, stop or None, step), in order."""
        ...


def is_selected(index: int, chosen: slice) -> bool:
    """Return whether a slice contains the number of a frame, which is below `chosen.stop`."""
    return index >= chosen.start and (index - chosen.start) % chosen.step == 0


def is_path(item: Any) -> bool:
    """Return whether an item is a path."""
    return isinstance(item, (str, os.PathLike))


def is_integer(value: Any) -> bool:
    """Return whether a value is an integer, and not a boolean."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


class SourceWarning(UserWarning):
    """A note on how a source is read.

    Files or streams are left out, frames are resampled, or ambiguous file names are read in one of
    several ways.

    Examples
    --------
    >>> import warnings
    >>> from tisfm.sources.frame_reader import SourceWarning
    >>> warnings.simplefilter("ignore", SourceWarning)
    """


def warn_notes(notes: Iterable[str], *, stacklevel: int = 2) -> None:
    """Issue each note as a `SourceWarning`; `stacklevel` as in `warnings.warn`."""
    for note in notes:
        warnings.warn(note, SourceWarning, stacklevel=stacklevel + 1)


@dataclass(frozen=True)
class Listing:
    """The number of files of a source, and a digest of their names and, for videos, their sizes.

    Processes on several machines compare their listings, so that all work on the same files.
    """

    count: int
    digest: str

    @classmethod
    def of(cls, files: Sequence[Path], *, with_sizes: bool = False) -> "Listing":
        """Return the listing of files in this order."""
        sizes = [f"/{path.stat().st_size}" if with_sizes else "" for path in files]
        names = "\0".join(f"{path.name}{size}" for path, size in zip(files, sizes, strict=True))
        return cls(len(files), hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest())

    def check(self, other: "Listing", title: str) -> None:
        """Raise RuntimeError if the listing of another process differs from this one."""
        if other != self:
            raise RunError(
                f"a worker sees other files in {title} ({other.count}) than the process that began "
                f"({self.count}): wait until all machines see the same, and give --resume"
            )
