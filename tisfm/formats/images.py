"""Pictures in the common formats, read whole or refused."""

import contextlib
import io
import os
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from tisfm.checks import unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.formats.atomic import atomic_write
from tisfm.formats.image_headers import FLOATS, PILLOW_FORMATS, TIFF, missing_part, refuse_large
from tisfm.formats.png import SIGNATURE, encode_png
from tisfm.formats.reading import FormatError, opencv_memory, read_bytes

IMAGE_SUFFIXES = (
    ".bmp", ".jp2", ".jpeg", ".jpg", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp",
)  # fmt: skip
"""Suffixes, lower case, of the files in a folder that count as pictures."""

_BITS_PER_SAMPLE, _EXTRA_SAMPLES = 258, 338  # tags of TIFF
_SEPARATE_ALPHA = (2,)  # colours were not multiplied by it
# PNG and JPEG begin so, and Pillow knows all of their kinds.
_KNOWN_BEGINNINGS = (SIGNATURE, b"\xff\xd8\xff")
# What OpenCV alone reads: kinds of TIFF, and the floats of PFM and Radiance.
_OTHER_BEGINNINGS = (*TIFF, *FLOATS)
_log_level_lock = threading.Lock()


def read_image(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read a picture, grey or colour, at its own depth.

    Transparency is dropped, and colours are those that the file holds: not mixed with a background,
    and neither multiplied nor divided by it. A palette becomes colours, and the orientation that a
    camera wrote beside a picture is applied. Of a file with several pictures the first is read.

    Parameters
    ----------
    path : str or os.PathLike
        File to read. What it is follows from its contents, not from its suffix.

    Returns
    -------
    (H, W) or (H, W, 3) uint8, uint16 or float32 ndarray
        Grey levels, or colours in the order red, green, blue, as stored: no factor is applied.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    IsADirectoryError
        If `path` is a folder.
    FormatError
        If the file is empty, not a picture, cut off, damaged, of another number type, or of more
        than 2²⁸ pixels.
    MemoryError
        If memory does not suffice for the picture.

    Notes
    -----
    Some versions of OpenCV return a picture that is complete only at its top for a file that is
    cut off. Every file is therefore checked first: PNG and TIFF against their own account of
    their length, and the formats of `IMAGE_SUFFIXES` by decoding them once more with Pillow, which
    is not asked about any other. What Pillow does not know of these (float colour TIFF), or
    refuses for its size alone (above 179 million pixels), and what else is read (Radiance HDR,
    PFM), is as safe as OpenCV makes it.

    Examples
    --------
    >>> from tisfm.formats import read_image
    >>> frame = read_image("frame0.png")
    >>> frame.shape, frame.dtype
    ((48, 64), dtype('uint8'))
    """
    name = os.fspath(path)
    data = read_bytes(name)
    missing = missing_part(data)
    if missing is not None:
        raise FormatError(f"{name} is cut off after {len(data)} bytes: {missing} is missing")
    if data.startswith(FLOATS):
        refuse_large(name, data)
    plain = _verify_with_pillow(name, data)
    if plain is not None:
        return plain
    image = decode(name, data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if image is None:  # float TIFF with transparency is read with it or not at all
        image = decode(name, data, cv2.IMREAD_UNCHANGED)
        if image is not None and image.ndim == 3:
            image = image[..., :3]
    if image is None:
        raise FormatError(
            f"{name} cannot be read as a picture ({len(data)} bytes, starting with {data[:8]!r}): "
            f"it is damaged or of an unknown format; convert it to PNG"
        )
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        raise FormatError(
            f"{name} holds {image.dtype} pixels, expected uint8, uint16 or float32: convert it"
        )
    if image.ndim == 3:
        with opencv_memory(name):
            return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return image


def write_png(path: str | os.PathLike[str], image: NDArray[Any]) -> None:
    """Write a picture as PNG, whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    image : (H, W) or (H, W, 3) uint8 or uint16 ndarray
        Grey levels, or colours in the order red, green, blue.

    Raises
    ------
    TypeError
        If `image` is not uint8 or uint16.
    ValueError
        If `image` has another shape, no pixels, or a masked value.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_image, write_png
    >>> write_png("deep.png", np.full((4, 6, 3), 40000, np.uint16))  # grey or RGB, 8 or 16 bits
    >>> int(read_image("deep.png").max())
    40000
    """
    image = unmasked(image, "image", advice="fill them first, for instance by image.filled(0)")
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.dtype not in (np.uint8, np.uint16):
        raise InputTypeError(f"image has dtype {image.dtype}, expected uint8 or uint16: convert it")
    colour = image.ndim == 3 and image.shape[2] == 3
    if image.size == 0 or not (image.ndim == 2 or colour):
        raise InputError(f"image is {image.shape}, expected (H, W) or (H, W, 3) with some pixels")
    with atomic_write(path) as file:
        file.writelines(encode_png(image))


def decode(name: str, data: bytes, flags: int) -> NDArray[Any] | None:
    """Return what OpenCV reads, blue first, or None; MemoryError if memory does not suffice."""
    with opencv_silenced(), opencv_memory(name):
        try:
            return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error as error:
            if error.code == cv2.Error.StsNoMem:
                raise
            return None


def _verify_with_pillow(name: str, data: bytes) -> NDArray[np.uint8] | None:
    """Raise FormatError if Pillow knows the format and cannot decode all of the picture.

    Returns the picture where OpenCV would multiply its colours by its transparency, else None.
    """
    try:
        with Image.open(io.BytesIO(data), formats=PILLOW_FORMATS) as picture:
            refuse_large(name, data, picture.width * picture.height)
            picture.load()
            separate = getattr(picture, "tag_v2", {}).get(_EXTRA_SAMPLES) == _SEPARATE_ALPHA
            if picture.mode == "RGBA" and separate and _eight_bits(picture):
                upright = ImageOps.exif_transpose(picture)
                return np.ascontiguousarray(np.asarray(upright)[..., :3])
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        # Too large for its taste: no verdict. (The warning is an exception only where the
        # application turned warnings into errors.)
        refuse_large(name, data)
        return None
    except (MemoryError, FormatError):
        raise
    except UnidentifiedImageError as error:
        refuse_large(name, data)
        if data.startswith(_KNOWN_BEGINNINGS):
            raise FormatError(f"{name} is damaged at its beginning: write it again") from error
        if not data.startswith(_OTHER_BEGINNINGS):
            raise FormatError(
                f"{name} cannot be read as a picture ({len(data)} bytes, starting with "
                f"{data[:8]!r}): it is damaged or of an unknown format; convert it to PNG"
            ) from error
    except Exception as error:  # Pillow's decoders raise whatever a damaged file leads them to
        raise FormatError(f"{name} is cut off or damaged: {error}") from error
    return None


def _eight_bits(picture: Image.Image) -> bool:
    """Return whether a TIFF has 8 bits a sample; of more, Pillow would drop some."""
    return set(getattr(picture, "tag_v2", {}).get(_BITS_PER_SAMPLE, ())) == {8}


@contextlib.contextmanager
def opencv_silenced() -> Iterator[None]:
    """Keep OpenCV from printing what is raised as one line here."""
    logging = cv2.utils.logging
    # The level belongs to the whole process: the lock makes sure that the value put back is the
    # application's, not another thread's silence.
    with _log_level_lock:
        level = logging.getLogLevel()
        logging.setLogLevel(logging.LOG_LEVEL_SILENT)
        try:
            yield
        finally:
            logging.setLogLevel(level)


def natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sort key by which frame2 comes before frame10, and frame02 always on the same side of it."""
    parts = re.split(r"(\d+)", str(path))
    # Decimal is what \d matches; a superscript two is a digit, but not a decimal one.
    numbered = [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]
    return numbered, str(path)
