"""Pictures of several frames: animated PNG, WebP, GIF and AVIF, and TIFF of several pages."""

import warnings
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from tisfm.formats.picture_size import PILLOW_FORMATS
from tisfm.formats.reading import open_file

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
