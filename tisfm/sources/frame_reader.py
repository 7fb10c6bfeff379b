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
    """A frame before cropping and shrinking."""

    index: int  # number in the source, from 0
    name: str
    image: np.ndarray  # (H, W) or (H, W, 3)
    time: float | None = None  # s, if known


@dataclass(frozen=True, kw_only=True, eq=False)
class BadFrame:
    """A damaged frame, with the error from reading the frame."""

    index: int  # number in the source, from 0
    name: str
    error: FormatError


@dataclass(frozen=True, kw_only=True, eq=False)
class SourceFrame:
    """A frame of a source."""

    index: int  # number in the source, from 0; skipped frames are counted
    # stem of the image file; else the stem of the video, ``frame`` or ``webcam``, with the number
    name: str
    # seconds since the first frame of a video or webcam, or the time in the file name
    time: float | None
    # (H, W) or (H, W, 3) array: the frame, cropped and shrunk if the source does so
    image: np.ndarray
    # (H, W) bool array: true for ignored pixels; None if the frame has no ignored pixels
    ignored: NDArray[np.bool_] | None = None
    # (H, W) uint8 array: given number of the moving object at each pixel, 0 for the background at
    # rest; None if the frame has no given labels
    labels: NDArray[np.uint8] | None = None
    # Whether a float frame with values from 0 to 1 is scaled to 0 to 255. False after a frame of
    # the source had larger values: then all frames of the source are on the 8-bit scale.
    scales_unit_range: bool = True
    # height and width before cropping and shrinking, px; None if the frame is unchanged
    full_shape: tuple[int, int] | None = None


class FrameReader(Protocol):
    """Reads the frames of one kind of source."""

    title: str  # name of the source in messages
    files: tuple[Path, ...]  # all files with frames
    names: tuple[str, ...] | None  # names of all frames if each frame has a file, else None
    prefix: str  # prefix of the names of numbered frames
    count: int | None  # number of frames, if it is known before reading
    stated_count: int | None  # number of frames that a video states; can be wrong by a few frames
    times: tuple[float, ...] | None  # times of all frames, s, if they are known before reading
    notes: tuple[str, ...]  # notes to the user on how the source is read
    can_read_ahead: bool  # whether frames may be read ahead in a thread

    def read(self, selection: slice) -> Iterator[RawFrame | BadFrame]:
        """Read, in order, the frames whose numbers the slice contains; its stop may be None."""
        ...


def is_selected(index: int, selection: slice) -> bool:
    """Return whether a slice contains the number of a frame, which is below `selection.stop`."""
    return index >= selection.start and (index - selection.start) % selection.step == 0


def is_path(item: Any) -> bool:
    """Return whether an item is a path."""
    return isinstance(item, (str, os.PathLike))


def is_integer(value: Any) -> bool:
    """Return whether a value is an integer; a boolean is no integer."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


class SourceWarning(UserWarning):
    """A note on how a source is read.

    Such notes tell that files or streams are left out, that frames are resampled, or how ambiguous
    file names are read.

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

    Processes on several machines compare their listings, to make sure that all read the same files.
    """

    count: int
    digest: str

    @classmethod
    def from_files(cls, files: Sequence[Path], *, with_sizes: bool = False) -> "Listing":
        """Return the listing of files in this order."""
        sizes = [f"/{path.stat().st_size}" if with_sizes else "" for path in files]
        names = "\0".join(f"{path.name}{size}" for path, size in zip(files, sizes, strict=True))
        return cls(len(files), hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest())

    def check(self, other: "Listing", title: str) -> None:
        """Raise RuntimeError if the listing of another process differs from this listing."""
        if other != self:
            raise RunError(
                f"a worker sees other files in {title} ({other.count}) than the first process "
                f"({self.count}): wait until all machines see the same files, and give --resume"
            )
