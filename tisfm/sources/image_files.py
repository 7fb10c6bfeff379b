"""Image files as a source of frames."""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image

from tisfm.formats import FormatError, read_image
from tisfm.formats.image_headers import PILLOW_FORMATS
from tisfm.formats.image_names import increasing_times, parse_times, unread_times_note
from tisfm.formats.reading import open_file
from tisfm.sources.frame_reader import BadFrame, RawFrame

_FORMATS = (*PILLOW_FORMATS, "GIF", "AVIF")
_MAX_OPENED_IMAGES = 100  # images of a folder whose frames are counted; set by hand


def count_frames(file: Path) -> int:
    """Return the number of frames of an image file; 1 if unknown.

    Further images in a JPEG (MPO) are not counted: they are previews, depth maps, gain maps, or the
    view of a second lens.
    """
    try:
        with warnings.catch_warnings(), open_file(file) as stream:
            warnings.simplefilter("ignore")  # Pillow warns of large images
            with Image.open(stream, formats=_FORMATS) as picture:
                return 1 if picture.format == "MPO" else int(getattr(picture, "n_frames", 1))
    except Exception:  # damaged files make Pillow's decoders raise many kinds of errors
        return 1


def animations_note(files: Sequence[Path]) -> str:
    """Return a note that only the first frame of a file is read; "" if all have one frame."""
    for file in files[:_MAX_OPENED_IMAGES]:
        count = count_frames(file)
        if count > 1:
            return (
                f"of pictures with several frames, such as {file.name} ({count}), only the first "
                "frame is read: save the frames as separate files to read all"
            )
    return ""


class ImageFiles:
    """Image files as frames.

    Raises FileNotFoundError if a file does not exist.
    """

    prefix = ""
    stated_count: int | None = None
    can_read_ahead = True

    def __init__(
        self,
        files: Sequence[Path],  # the files in the order of the frames
        title: str,  # name of the source in messages
        notes: Sequence[str] = (),  # notes to the user on the selection of the files
    ) -> None:
        for file in files:
            if not file.exists():
                raise FileNotFoundError(f"there is no file {file}: check the path")
        self.title = title
        self.files = tuple(files)
        self.count: int | None = len(files)
        stems = [file.stem for file in files]
        self.times = increasing_times(stems)
        parsed_times = parse_times(stems)
        note = (
            unread_times_note(stems)
            if parsed_times is None
            else parsed_times.note(stems)
            if self.times
            else ""
        )
        self.notes = (*notes, *filter(None, (note, animations_note(files))))
        # Files of different folders or suffixes may have the same stem, but the names of results
        # must differ, also on file systems that ignore case.
        if len({stem.lower() for stem in stems}) < len(stems):
            stems = [f"{index:06d}_{stem}" for index, stem in enumerate(stems)]
        self._names = tuple(stems)
        self.names: tuple[str, ...] | None = self._names

    def read(self, selection: slice) -> Iterator[RawFrame | BadFrame]:
        """Read the files whose numbers the slice contains."""
        for index in range(len(self.files))[selection]:
            name = self._names[index]
            try:
                image = read_image(self.files[index])
            except FormatError as error:
                error.args = (f"frame {index}: {error}",)
                yield BadFrame(index=index, name=name, error=error)
                continue
            time = None if self.times is None else self.times[index]
            yield RawFrame(index=index, name=name, image=image, time=time)
            del image  # free its memory before the next image is read
