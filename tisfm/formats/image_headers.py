"""What an image file states about itself: its size in pixels, and where its parts end.

PNG and TIFF state where each of their parts ends. Checking that before decoding is exact, and keeps
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

MAX_IMAGE_PIXELS = 2**28
"""Pixels beyond which no image is read: a damaged file of kilobytes may state any number."""

PILLOW_FORMATS = ("BMP", "JPEG", "JPEG2000", "PNG", "PPM", "TIFF", "WEBP")
"""Pillow's names of the formats that it may decode here; for some others it runs other programs."""

FLOAT_SIGNATURES = (b"PF", b"Pf", b"#?")
"""First bytes of PFM files, colour and grey, and of Radiance HDR files."""

TIFF_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF files (little- and big-endian) and of BigTIFF files."""

_RADIANCE_SIZE = re.compile(rb"[-+][XY] +(\d{1,18}) +[-+][XY] +(\d{1,18})\s")
_PFM_SIZE = re.compile(rb"\AP[Ff]\s+(\d{1,18})\s+(\d{1,18})\s+[-+.\deE]+\s")
_MAX_FLOAT_HEADER = 64 * 1024  # bytes: a Radiance or PFM file states its size before
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # samples per pixel, by colour type
_DEFLATE_RATIO = 1032  # bytes that one byte of a deflate stream unpacks to, at most
# NumPy types of TIFF value types: byte, ASCII, short, long, rational (as bytes), ... long8, ifd8.
_TIFF_TYPES = {
    1: "u1", 2: "u1", 3: "u2", 4: "u4", 5: "V8", 6: "i1", 7: "u1", 8: "i2", 9: "i4", 10: "V8",
    11: "f4", 12: "f8", 13: "u4", 16: "u8", 17: "i8", 18: "u8",
}  # fmt: skip
_SIZE_TAGS = (256, 257)  # ImageWidth, ImageLength
_STRIP_TAGS = (273, 279)  # StripOffsets, StripByteCounts
_TILE_TAGS = (324, 325)  # TileOffsets, TileByteCounts


def find_missing_part(
    data: bytes,  # the whole file
) -> str | None:
    """Name the first part of a PNG or TIFF file that lies beyond the end of the file.

    Returns the part, such as "its end mark"; None if no part is missing, and for other formats.
    """
    if data.startswith(SIGNATURE):
        return _missing_part_of_png(data)
    if data.startswith(TIFF_SIGNATURES):
        try:
            return _missing_part_of_tiff(data)
        except (struct.error, OverflowError):  # OverflowError: an offset beyond 2⁶³
            return "its directory"
    return None


def refuse_large_image(
    name: str,  # name of the file, for the message
    data: bytes,  # the whole file
    pixels: int | None = None,  # number of pixels; read from the header of the file if not given
) -> None:
    """Raise FormatError for an image of more than `MAX_IMAGE_PIXELS` pixels."""
    pixels = _stated_pixels(data) if pixels is None else pixels
    if pixels is None and data.startswith(FLOAT_SIGNATURES):
        # OpenCV may take other numbers in the file for its size.
        raise FormatError(f"{name} is damaged: it states no size")
    if pixels is not None and pixels > MAX_IMAGE_PIXELS:
        raise FormatError(
            f"{name} is a picture of {pixels} pixels, more than {MAX_IMAGE_PIXELS}: it is damaged, "
            "or has to be shrunk"
        )


def _stated_pixels(data: bytes) -> int | None:
    """Return the number of pixels that a file states; None if its format is unknown."""
    if data.startswith(FLOAT_SIGNATURES):
        pattern = _RADIANCE_SIZE if data.startswith(b"#?") else _PFM_SIZE
        # The largest of several matches: a comment may contain a size as well.
        return max(
            (int(match[1]) * int(match[2]) for match in pattern.finditer(data[:_MAX_FLOAT_HEADER])),
            default=None,
        )
    if data.startswith(TIFF_SIGNATURES):
        return _tiff_pixels(data)
    Image.init()
    for image_format in PILLOW_FORMATS:
        open_image, accepts = Image.OPEN[image_format]
        try:
            if accepts is None or accepts(data[:16]) is True:
                # Image.open would refuse images above a limit of its own.
                with open_image(io.BytesIO(data), "") as image:
                    return image.width * image.height
        except MemoryError:
            raise
        except Exception:  # damaged files make Pillow's decoders raise many kinds of errors
            continue
    return None


def _missing_part_of_png(data: bytes) -> str | None:
    """Walk the chunks (length, type, payload, check sum) up to the end mark."""
    position, packed_bytes, pixel_bytes = len(SIGNATURE), 0, 0
    while position + 12 <= len(data):
        length, chunk_type = struct.unpack_from(">I4s", data, position)
        if chunk_type == b"IHDR" and length == 13 and position + 25 <= len(data):
            width, height, bits, colour_type = struct.unpack_from(">IIBB", data, position + 8)
            pixel_bytes = height * -(-width * bits * _PNG_CHANNELS.get(colour_type, 1) // 8)
        if chunk_type == b"IDAT":
            packed_bytes += length
        position += 12 + length
        if chunk_type == b"IEND" and position <= len(data):
            # A header with a false size would make decoders allocate memory for missing pixels.
            return None if pixel_bytes <= _DEFLATE_RATIO * packed_bytes else "part of its pixels"
    return "its end mark"


def _tiff_pixels(data: bytes) -> int | None:
    """Return the number of pixels that a TIFF file states, None if it states none."""
    values, _ = _tiff_values(data)
    sides = [int(values[tag][0]) for tag in _SIZE_TAGS if tag in values]
    return sides[0] * sides[1] if len(sides) == 2 else None


def _missing_part_of_tiff(data: bytes) -> str | None:
    """Check the first directory, the values it points to, and the strips or tiles of pixels.

    Raises ``struct.error`` or ``OverflowError`` where the directory itself is cut off.
    """
    values, missing_part = _tiff_values(data)
    if missing_part is not None:
        return missing_part
    for offsets_tag, lengths_tag in (_STRIP_TAGS, _TILE_TAGS):
        offsets = values.get(offsets_tag, np.empty(0)).tolist()
        lengths = values.get(lengths_tag, np.empty(0)).tolist()
        # Some writers leave one of the two tags out: then only decoding finds missing pixels.
        if any(start + length > len(data) for start, length in zip(offsets, lengths, strict=False)):
            return "part of its pixels"
    return None


def _tiff_values(data: bytes) -> tuple[dict[int, NDArray[np.generic]], str | None]:
    """Return the integers of the first directory by their tags, and the part that is missing."""
    byte_order = "<" if data[:2] == b"II" else ">"
    is_big_tiff = 43 in data[2:4]  # BigTIFF: 64-bit offsets and counts
    offset_type, count_type = ("Q", "Q") if is_big_tiff else ("I", "H")
    (directory,) = struct.unpack_from(byte_order + offset_type, data, 8 if is_big_tiff else 4)
    (entries,) = struct.unpack_from(byte_order + count_type, data, directory)
    position = directory + struct.calcsize(byte_order + count_type)
    values: dict[int, NDArray[np.generic]] = {}
    for _ in range(entries):
        tag, value_type, count = struct.unpack_from(byte_order + "HH" + offset_type, data, position)
        inline_bytes = struct.calcsize(byte_order + offset_type)
        start = position + 4 + inline_bytes
        position = start + inline_bytes
        if value_type not in _TIFF_TYPES or count == 0:
            continue  # a type of a later version, or no value: readers skip such entries
        dtype = np.dtype(byte_order + _TIFF_TYPES[value_type])
        if dtype.itemsize * count > inline_bytes:
            (start,) = struct.unpack_from(byte_order + offset_type, data, start)
        if start + dtype.itemsize * count > len(data):
            return values, f"the value of its tag {tag}"
        if dtype.kind in "ui":
            values[tag] = np.frombuffer(data, dtype, count, start)
    struct.unpack_from(byte_order + offset_type, data, position)  # the offset of the next directory
    return values, None
