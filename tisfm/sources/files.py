"""Image files as a source, and the times that their names state."""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from tisfm.formats import FormatError, read_image
from tisfm.sources.reading import BadFrame, RawFrame

_SECONDS = re.compile(r"\d+\.\d+")
_NANOSECONDS = re.compile(r"\d{19}")


class ImageFiles:
    """Image files, read one after the other.

    Parameters
    ----------
    files : sequence of Path
        In the order of the frames.
    title : str
        What errors call them all.

    Raises
    ------
    FileNotFoundError
        If one of them does not exist.
    """

    prefix = ""
    announced: int | None = None
    ahead = True

    def __init__(self, files: Sequence[Path], title: str) -> None:
        for file in files:
            if not file.exists():
                raise FileNotFoundError(f"there is no file {file}: check the path")
        self.title = title
        self.files = tuple(files)
        self.count: int | None = len(files)
        stems = [file.stem for file in files]
        self._times = times_of_names(stems)
        # Of different folders or suffixes; some file systems take a and A for the same.
        if len({stem.lower() for stem in stems}) < len(stems):
            stems = [f"{index:06d}_{stem}" for index, stem in enumerate(stems)]
        self._names = tuple(stems)
        self.names: tuple[str, ...] | None = self._names

    def read(self, chosen: slice) -> Iterator[RawFrame | BadFrame]:
        """Read the files of these numbers."""
        for index in range(len(self.files))[chosen]:
            name = self._names[index]
            try:
                image = read_image(self.files[index])
            except FormatError as error:
                error.args = (f"frame {index}: {error}",)
                yield BadFrame(index=index, name=name, error=error)
                continue
            time = None if self._times is None else self._times[index]
            yield RawFrame(index=index, name=name, image=image, time=time)
            del image  # or it would be held while the next one is read


def times_of_names(stems: Sequence[str]) -> tuple[float, ...] | None:
    """Return the times, in seconds, that are the names of image files.

    Parameters
    ----------
    stems : sequence of str
        Names without their suffix.

    Returns
    -------
    tuple of float or None
        If every name is a number of seconds with its decimals, as in TUM's sequences
        (``1305031102.175304``), or a number of nanoseconds of 19 digits, as in EuRoC's
        (``1403636579763555584``), and each is later than the one before. None for other names:
        they may be numbers of frames.
    """
    for pattern, unit in ((_SECONDS, 1.0), (_NANOSECONDS, 1e9)):
        if all(pattern.fullmatch(stem) for stem in stems):
            times = tuple(float(stem) / unit for stem in stems)
            rising = all(later > sooner for sooner, later in pairwise(times))
            return times if rising else None
    return None
