"""Image files as a source of frames."""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image

from tisfm.formats import FormatError, read_image
from tisfm.formats.image_headers import PILLOW_FORMATS
from tisfm.formats.image_names import named_times, times_of_names, unread_note
from tisfm.formats.reading import open_file
from tisfm.sources.frame_reader import BadFrame, RawFrame

_FORMATS = (*PILLOW_FORMATS, "GIF", "AVIF")
_LOOKED_AT = 100  # pictures of a folder, at most: each is opened


def frames_in_picture(file: Path) -> int:
    """Return how many frames a picture has; 1 if that is not known.

    Further pictures in a JPEG (MPO) are previews, depth or gain maps, or the view of a second lens:
    they are not counted.
    """
    try:
        with warnings.catch_warnings(), open_file(file) as opened:
            warnings.simplefilter("ignore")  # of large pictures
            with Image.open(opened, formats=_FORMATS) as picture:
                return 1 if picture.format == "MPO" else int(getattr(picture, "n_frames", 1))
    except Exception:  # Pillow's decoders raise many kinds for damaged files
        return 1


def animations_note(files: Sequence[Path]) -> str:
    """Return a note that only first frames are read, "" if all pictures have one frame."""
    for file in files[:_LOOKED_AT]:
        count = frames_in_picture(file)
        if count > 1:
            return (
                f"of pictures with several frames, such as {file.name} ({count}), only the first "
                "frame is read: save the frames as separate files to read all"
            )
    return ""


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
