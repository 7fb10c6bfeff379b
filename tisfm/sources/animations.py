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
    except Exception:  # Pillow's decoders raise whatever a damaged file leads them to
        return 1


def animations_note(files: Sequence[Path]) -> str:
    """Return that only the first frame of a picture is read, "" if the pictures have one each."""
    for file in files[:_LOOKED_AT]:
        count = frames_in_picture(file)
        if count > 1:
            return (
                f"only the first of the {count} frames of {file.name} is read, and so of other "
                "pictures with several frames: save the frames as files of their own to have all"
            )
    return ""
