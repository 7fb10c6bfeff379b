"""What an image file states about itself: its size in pixels, and where its parts end.

PNG and TIFF say where each of their parts ends. Checking that before decoding is exact, and keeps
libpng and libtiff from printing complaints of their own to standard error.
"""

import io
import re
import struct

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.formats.png import SIGNATURE
from tisfm.formats.reading import FormatError

# TIFF value types to NumPy: byte, ASCII, short, long, rational (as bytes), ... long8, ifd8.
_TIFF_TYPES = {
    1: "u1", 2: "u1", 3: "u2", 4: "u4", 5: "V8", 6: "i1", 7: "u1", 8: "i2", 9: "i4", 10: "V8",
    11: "f4", 12: "f8", 13: "u4", 16: "u8", 17: "i8", 18: "u8",
}  # fmt: skip
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # what the files begin with
_SIDE_TAGS = (256, 257)  # ImageWidth, ImageLength
_STRIP_TAGS = (273, 279)  # StripOffsets, StripByteCounts
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by the type of colour
_DEFLATE = 1032  # bytes that one packed byte may hold, at most
_TILE_TAGS = (324, 325)  # TileOffsets, TileByteCounts


def missing_part(data: bytes) -> str | None:
    """Name the first part of a PNG or TIFF file that lies beyond its end.

    Parameters
    ----------
    data : bytes
        The whole file.

    Returns
    -------
    str or None
        What is missing, such as "its end mark"; None if nothing is, or for another format.
    """
    if data.startswith(SIGNATURE):
        return _missing_from_png(data)
    if data.startswith(TIFF):
        try:
            return _missing_from_tiff(data)
        except (struct.error, OverflowError):  # of offsets beyond 2⁶³
            return "its directory"
    return None


def _missing_from_png(data: bytes) -> str | None:
    """Walk the chunks (length, type, payload, check sum) up to the end mark."""
    position, packed, pixels = len(SIGNATURE), 0, 0
    while position + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        if kind == b"IHDR" and length == 13 and position + 25 <= len(data):
            width, height, bits, colours = struct.unpack_from(">IIBB", data, position + 8)
            pixels = height * -(-width * bits * _PNG_CHANNELS.get(colours, 1) // 8)
        if kind == b"IDAT":
            packed += length
        position += 12 + length
        if kind == b"IEND" and position <= len(data):
            # A header that lies would have memory taken for pixels that are not there.
            return None if pixels <= _DEFLATE * packed else "part of its pixels"
    return "its end mark"


def tiff_pixels(data: bytes) -> int | None:
    """Return the number of pixels that a TIFF file states, None if it states none."""
    values, _ = _tiff_values(data)
    sides = [int(values[tag][0]) for tag in _SIDE_TAGS if tag in values]
    return sides[0] * sides[1] if len(sides) == 2 else None


def _missing_from_tiff(data: bytes) -> str | None:
    """Check the first directory, the values it points to, and the strips or tiles of pixels.

    Raises ``struct.error`` or ``OverflowError`` where the directory itself is cut off.
    """
    values, missing = _tiff_values(data)
    if missing is not None:
        return missing
    for offsets_tag, lengths_tag in (_STRIP_TAGS, _TILE_TAGS):
        offsets = values.get(offsets_tag, np.empty(0)).tolist()
        lengths = values.get(lengths_tag, np.empty(0)).tolist()
        # One may be left out by a sloppy writer, in which case the decoder has the last word.
        if any(start + length > len(data) for start, length in zip(offsets, lengths, strict=False)):
            return "part of its pixels"
    return None


def _tiff_values(data: bytes) -> tuple[dict[int, NDArray[np.generic]], str | None]:
    """Return the whole numbers of the first directory by their tags, and what is missing of it."""
    order = "<" if data[:2] == b"II" else ">"
    big = 43 in data[2:4]  # BigTIFF: 64-bit offsets and counts
    offset_type, count_type = ("Q", "Q") if big else ("I", "H")
    (directory,) = struct.unpack_from(order + offset_type, data, 8 if big else 4)
    (entries,) = struct.unpack_from(order + count_type, data, directory)
    position = directory + struct.calcsize(order + count_type)
    values: dict[int, NDArray[np.generic]] = {}
    for _ in range(entries):
        tag, kind, count = struct.unpack_from(order + "HH" + offset_type, data, position)
        inline = struct.calcsize(order + offset_type)
        start = position + 4 + inline
        position = start + inline
        if kind not in _TIFF_TYPES or count == 0:
            continue  # a type of later years, or nothing: readers skip it as well
        dtype = np.dtype(order + _TIFF_TYPES[kind])
        if dtype.itemsize * count > inline:
            (start,) = struct.unpack_from(order + offset_type, data, start)
        if start + dtype.itemsize * count > len(data):
            return values, f"the value of its tag {tag}"
        if dtype.kind in "ui":
            values[tag] = np.frombuffer(data, dtype, count, start)
    struct.unpack_from(order + offset_type, data, position)  # where the next directory is
    return values, None


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
