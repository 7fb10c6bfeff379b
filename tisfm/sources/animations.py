"""Pictures of several frames: animated PNG, WebP, GIF and AVIF, and TIFF of several pages."""

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from tisfm.formats.picture_size import PILLOW_FORMATS

_FORMATS = (*PILLOW_FORMATS, "GIF", "AVIF")
_LOOKED_AT = 100  # pictures of a folder, at most: each is opened


def frames_in_picture(file: Path) -> int:
    """Return how many frames a picture has; 1 if that is not known."""
    try:
        with Image.open(file, formats=_FORMATS) as picture:
            return int(getattr(picture, "n_frames", 1))
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
