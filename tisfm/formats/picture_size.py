"""How many pixels a picture has by its own account, before any of them is decoded."""

import io
import re

from PIL import Image

from tisfm.formats.completeness import TIFF, tiff_pixels
from tisfm.formats.errors import FormatError

LARGEST_PICTURE = 2**28
"""Pixels beyond which no picture is read: a file of kilobytes may state any number."""

PILLOW_FORMATS = ("BMP", "JPEG", "JPEG2000", "PNG", "PPM", "TIFF", "WEBP")
"""Pillow's names of the formats that are read; of the others some run other programs."""

FLOATS = (b"PF", b"Pf", b"#?")
"""What PFM and Radiance files begin with."""

_RADIANCE = re.compile(rb"[-+][XY] +(\d{1,18}) +[-+][XY] +(\d{1,18})\s")
_FLOATS = re.compile(rb"\AP[Ff]\s+(\d{1,18})\s+(\d{1,18})\s+[-+.\deE]+\s")
_HEADER = 64 * 1024  # bytes in which a Radiance file states its size


def refuse_large(name: str, data: bytes, pixels: int | None = None) -> None:
    """Raise FormatError for a picture of more than `LARGEST_PICTURE` pixels.

    Parameters
    ----------
    name : str
        What the error calls it.
    data : bytes
        The whole file.
    pixels : int, optional
        What it has, where that is known.
    """
    pixels = _stated(data) if pixels is None else pixels
    if pixels is None and data.startswith(FLOATS):  # OpenCV may see a size where there is none
        raise FormatError(f"{name} is damaged: it states no size")
    if pixels is not None and pixels > LARGEST_PICTURE:
        raise FormatError(
            f"{name} is a picture of {pixels} pixels, more than {LARGEST_PICTURE}: it is damaged, "
            "or has to be shrunk"
        )


def _stated(data: bytes) -> int | None:
    """Return the number of pixels, None of an unknown format."""
    if data.startswith(FLOATS):
        header = _RADIANCE if data.startswith(b"#?") else _FLOATS
        # The largest: a comment may state a size as well.
        return max(
            (int(found[1]) * int(found[2]) for found in header.finditer(data[:_HEADER])),
            default=None,
        )
    if data.startswith(TIFF):
        return tiff_pixels(data)
    Image.init()
    for kind in PILLOW_FORMATS:
        open_picture, known = Image.OPEN[kind]
        try:
            if known is None or known(data[:16]) is True:
                # Not by Image.open, which refuses what is too large for its own taste.
                with open_picture(io.BytesIO(data), "") as picture:
                    return picture.width * picture.height
        except MemoryError:
            raise
        except Exception:  # Pillow's decoders raise whatever a damaged file leads them to
            continue
    return None
