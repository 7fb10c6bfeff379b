"""The protocol of a frame reader, the frames it yields, and the warnings about how it reads."""

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
    """A frame as it was read: its number in the source, its name, its time in seconds if known."""

    index: int
    name: str
    image: np.ndarray
    time: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class BadFrame:
    """A frame that is damaged, and the error that says so."""

    index: int
    name: str
    error: FormatError


@dataclass(frozen=True, kw_only=True, eq=False)
class SourceFrame:
    """A frame of a source.

    Attributes
    ----------
    index : int
        Its number in the source, from 0; frames that were left out count.
    name : str
        Stem of its file; or that of the video, ``frame`` or ``webcam``, with its number.
    time : float or None
        Seconds: since the first frame of a video or webcam, or what the name of its file says.
    image : (H, W) or (H, W, 3) array
        Cropped and shrunk, where the source was told to.
    ignored : (H, W) bool array, or None
        Where pixels do not count; None where all do.
    labels : (H, W) uint8 array, or None
        Which thing each pixel belongs to, where that is given: 0 is at rest.
    stretch : bool
        False where the frames so far show that float frames of the source are on the 8-bit scale,
        though this one may look as if it were in [0, 1].
    full : (int, int) or None
        Height and width before it was cropped or shrunk, px; None where it was not.
    """

    index: int
    name: str
    time: float | None
    image: np.ndarray
    ignored: NDArray[np.bool_] | None = None
    labels: NDArray[np.uint8] | None = None
    stretch: bool = True
    full: tuple[int, int] | None = None


class Reader(Protocol):
    """One kind of source.

    Attributes
    ----------
    title : str
        What errors call it.
    files : tuple of Path
        All files that it reads frames from.
    names : tuple of str or None
        Names of all frames, where they have files of their own.
    prefix : str
        What names begin with, where they are numbered.
    count : int or None
        Number of frames, where it is known beforehand.
    announced : int or None
        Number of frames that the source states, where it may be wrong by a few.
    times : tuple of float or None
        Of all frames, s, if they are known before reading.
    notes : tuple of str
        On how the source is read.
    ahead : bool
        Whether frames may be read in another thread, before they are asked for.
    """

    title: str
    files: tuple[Path, ...]
    names: tuple[str, ...] | None
    prefix: str
    count: int | None
    announced: int | None
    times: tuple[float, ...] | None
    notes: tuple[str, ...]
    ahead: bool

    def read(self, chosen: slice) -> Iterator[RawFrame | BadFrame]:
        """Read the frames of these numbers (start, stop or None, step), in order."""
        ...


def is_chosen(index: int, chosen: slice) -> bool:
    """Return whether a frame before `chosen.stop` is one of those that are read."""
    return index >= chosen.start and (index - chosen.start) % chosen.step == 0


def is_path(item: Any) -> bool:
    """Return whether an item is the path of a file."""
    return isinstance(item, (str, os.PathLike))


def is_whole(value: Any) -> bool:
    """Return whether a value is a whole number, and no truth value."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


class SourceWarning(UserWarning):
    """Files or streams are left out, frames are resampled, or names or times are read in one way.

    Examples
    --------
    >>> import warnings
    >>> from tisfm.sources.frame_reader import SourceWarning
    >>> warnings.simplefilter("ignore", SourceWarning)
    """


def warn_of(notes: Iterable[str], *, stacklevel: int = 2) -> None:
    """Give each note as a `SourceWarning` at the caller, or further up, as `warnings.warn` does."""
    for note in notes:
        warnings.warn(note, SourceWarning, stacklevel=stacklevel + 1)


@dataclass(frozen=True)
class Listing:
    """How many files there are, and a digest of their names, and of their sizes if these count."""

    count: int
    digest: str

    @classmethod
    def of(cls, files: Sequence[Path], *, with_sizes: bool = False) -> "Listing":
        """Return that of files in their order."""
        sizes = [f"/{path.stat().st_size}" if with_sizes else "" for path in files]
        names = "\0".join(f"{path.name}{size}" for path, size in zip(files, sizes, strict=True))
        return cls(len(files), hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest())

    def check(self, other: "Listing", title: str) -> None:
        """Refuse what another process sees, with RuntimeError, if it is not the same."""
        if other != self:
            raise RunError(
                f"a worker sees other files in {title} ({other.count}) than the process that began "
                f"({self.count}): wait until all machines see the same, and give --resume"
            )
