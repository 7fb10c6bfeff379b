"""Image files as a source."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from tisfm.formats import FormatError, read_image
from tisfm.formats.time_names import named_times, times_of_names, unread_note
from tisfm.sources.animations import animations_note
from tisfm.sources.reading import BadFrame, RawFrame


class ImageFiles:
    """Image files, read one after the other.

    Parameters
    ----------
    files : sequence of Path
        In the order of the frames.
    title : str
        What errors call them all.
    notes : sequence of str
        On how they were found.

    Raises
    ------
    FileNotFoundError
        If one of them does not exist.
    """

    prefix = ""
    announced: int | None = None
    ahead = True

    def __init__(self, files: Sequence[Path], title: str, notes: Sequence[str] = ()) -> None:
        for file in files:
            if not file.exists():
                raise FileNotFoundError(f"there is no file {file}: check the path")
        self.title = title
        self.files = tuple(files)
        self.count: int | None = len(files)
        stems = [file.stem for file in files]
        self.times = times_of_names(stems)
        named = named_times(stems)
        note = unread_note(stems) if named is None else named.note(stems) if self.times else ""
        self.notes = (*notes, *filter(None, (note, animations_note(files))))
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
            time = None if self.times is None else self.times[index]
            yield RawFrame(index=index, name=name, image=image, time=time)
            del image  # or it would be held while the next one is read
