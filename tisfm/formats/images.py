"""Pictures in the common formats, read whole or refused."""

import contextlib
import io
import os
import threading
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from tisfm.formats.atomic import atomic_write
from tisfm.formats.completeness import missing_part
from tisfm.formats.errors import FormatError
from tisfm.formats.png import encode_png
from tisfm.formats.reading import read_bytes

IMAGE_SUFFIXES = (
    ".bmp", ".jp2", ".jpeg", ".jpg", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp",
)  # fmt: skip
"""Suffixes, lower case, of the files in a folder that count as pictures."""

# PNG and JPEG begin so, and Pillow knows all of their kinds.
_KNOWN_BEGINNINGS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")
_log_level_lock = threading.Lock()


def read_image(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read a picture, grey or colour, at its own depth.

    Transparency is dropped, a palette becomes colours, and the orientation that a camera wrote
    beside a picture is applied. Of a file with several pictures the first is read.

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
        If the file is empty, not a picture, cut off, damaged, or of another number type.

    Notes
    -----
    Some versions of OpenCV return a picture that is complete only at its top for a file that is
    cut off. Every file is therefore checked first: PNG and TIFF against their own account of
    their length, and all that Pillow knows by decoding it once more with Pillow. What Pillow does
    not know (Radiance HDR, colour PFM, float colour TIFF), or refuses for its size alone
    (above 179 million pixels), is as safe as OpenCV makes it.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    missing = missing_part(data)
    if missing is not None:
        raise FormatError(f"{name} is cut off after {len(data)} bytes: {missing} is missing")
    _verify_with_pillow(name, data)
    with _opencv_silenced():
        try:
            image = cv2.imdecode(
                np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR
            )
        except cv2.error:
            image = None
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
        return np.ascontiguousarray(image[..., ::-1])
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
        If `image` has another shape or no pixels.
    OSError
        If the file cannot be written.
    """
    image = np.asarray(image)
    if image.dtype not in (np.uint8, np.uint16):
        raise TypeError(f"image has dtype {image.dtype}, expected uint8 or uint16: convert it")
    colour = image.ndim == 3 and image.shape[2] == 3
    if image.size == 0 or not (image.ndim == 2 or colour):
        raise ValueError(f"image is {image.shape}, expected (H, W) or (H, W, 3) with some pixels")
    with atomic_write(path) as file:
        file.writelines(encode_png(image))


def _verify_with_pillow(name: str, data: bytes) -> None:
    """Raise FormatError if Pillow knows the format and cannot decode all of the picture."""
    try:
        with Image.open(io.BytesIO(data)) as picture:
            picture.load()
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        # Too large for its taste: no verdict. (The warning is an exception only where the
        # application turned warnings into errors.)
        return
    except UnidentifiedImageError as error:
        if data.startswith(_KNOWN_BEGINNINGS):
            raise FormatError(f"{name} is damaged at its beginning: write it again") from error
    except Exception as error:  # Pillow's decoders raise whatever a damaged file leads them to
        raise FormatError(f"{name} is cut off or damaged: {error}") from error


@contextlib.contextmanager
def _opencv_silenced() -> Iterator[None]:
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
