"""Pictures of several frames: animated PNG and WebP, and TIFF of several pages."""

from pathlib import Path

from PIL import Image

from tisfm.formats.picture_size import PILLOW_FORMATS


def frames_in_picture(file: Path) -> int:
    """Return how many frames a picture has; 1 if that is not known."""
    try:
        with Image.open(file, formats=PILLOW_FORMATS) as picture:
            return int(getattr(picture, "n_frames", 1))
    except Exception:  # Pillow's decoders raise whatever a damaged file leads them to
        return 1
