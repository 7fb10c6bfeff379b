"""Images in the common formats. A file that is cut off or damaged is refused."""

import contextlib
import io
import os
import threading
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from tisfm.checks import check_unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.formats.atomic import atomic_write
from tisfm.formats.image_headers import (
    FLOAT_SIGNATURES,
    PILLOW_FORMATS,
    TIFF_SIGNATURES,
    find_missing_part,
    refuse_large_image,
)
from tisfm.formats.png import SIGNATURE, encode_png
from tisfm.formats.reading import FormatError, opencv_memory_errors, read_bytes

IMAGE_SUFFIXES = (
    ".bmp", ".jp2", ".jpeg", ".jpg", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp",
)  # fmt: skip
"""Suffixes, lower case, of the files in a folder that count as images."""

_BITS_PER_SAMPLE = 258  # tag of TIFF
_EXTRA_SAMPLES = 338  # tag of TIFF
_UNASSOCIATED_ALPHA = (2,)  # value of _EXTRA_SAMPLES: colours not multiplied by transparency
# First bytes of PNG and JPEG, of which Pillow can read every kind.
_PILLOW_SIGNATURES = (SIGNATURE, b"\xff\xd8\xff")
# First bytes of formats of which OpenCV reads kinds that Pillow does not: TIFF, PFM, Radiance.
_OPENCV_SIGNATURES = (*TIFF_SIGNATURES, *FLOAT_SIGNATURES)
_log_level_lock = threading.Lock()


def read_image(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read an image, grey or colour, at its own bit depth.

    Transparency is dropped: colours are returned as stored, not mixed with a background, and
    neither multiplied nor divided by the transparency. A palette becomes colours, and the EXIF
    orientation is applied. Of a file with several images the first is read.

    Parameters
    ----------
    path : str or os.PathLike
        File to read. Its contents tell the format, not its suffix.

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
        If the file is empty, not an image, cut off, damaged, of another number type, or of more
        than 2²⁸ pixels.
    MemoryError
        If memory does not suffice for the image.

    Notes
    -----
    For a file that is cut off, some versions of OpenCV return an image that is complete only at its
    top. Every file is therefore checked first: PNG and TIFF by the lengths that they state, and the
    formats of `IMAGE_SUFFIXES` by decoding them with Pillow as well. OpenCV alone checks the images
    that Pillow cannot read (float colour TIFF), the images that Pillow refuses as too large (above
    179 million pixels), and other formats (Radiance HDR, PFM).

    Examples
    --------
    >>> from tisfm.formats import read_image
    >>> frame = read_image("frame0.png")
    >>> frame.shape, frame.dtype
    ((48, 64), dtype('uint8'))
    """
    name = os.fspath(path)
    data = read_bytes(name)
    missing_part = find_missing_part(data)
    if missing_part is not None:
        raise FormatError(f"{name} is cut off after {len(data)} bytes: {missing_part} is missing")
    if data.startswith(FLOAT_SIGNATURES):
        refuse_large_image(name, data)
    decoded = _check_with_pillow(name, data)
    if decoded is not None:
        return decoded
    image = decode_with_opencv(name, data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if image is None:  # OpenCV reads a float TIFF with transparency only with this flag
        image = decode_with_opencv(name, data, cv2.IMREAD_UNCHANGED)
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
        with opencv_memory_errors(name):
            return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return image


def write_png(path: str | os.PathLike[str], image: NDArray[Any]) -> None:
    """Write an image as PNG; after an error there is no incomplete file.

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
    image = check_unmasked(
        image, "image", advice="fill them first, for instance by image.filled(0)"
    )
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.dtype not in (np.uint8, np.uint16):
        raise InputTypeError(f"image has dtype {image.dtype}, expected uint8 or uint16: convert it")
    is_colour = image.ndim == 3 and image.shape[2] == 3
    if image.size == 0 or not (image.ndim == 2 or is_colour):
        raise InputError(f"image is {image.shape}, expected (H, W) or (H, W, 3) with some pixels")
    with atomic_write(path) as file:
        file.writelines(encode_png(image))


def decode_with_opencv(name: str, data: bytes, flags: int) -> NDArray[Any] | None:
    """Return the image that OpenCV decodes, blue first; None if OpenCV cannot decode it.

    MemoryError if memory does not suffice.
    """
    with silence_opencv(), opencv_memory_errors(name):
        try:
            return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error as error:
            if error.code == cv2.Error.StsNoMem:
                raise
            return None


def _check_with_pillow(name: str, data: bytes) -> NDArray[np.uint8] | None:
    """Raise FormatError if Pillow knows the format and cannot decode the whole image.

    Returns the image where OpenCV would multiply its colours by its transparency, else None.
    """
    try:
        with Image.open(io.BytesIO(data), formats=PILLOW_FORMATS) as picture:
            refuse_large_image(name, data, picture.width * picture.height)
            picture.load()
            alpha_kind = getattr(picture, "tag_v2", {}).get(_EXTRA_SAMPLES)
            is_unassociated = alpha_kind == _UNASSOCIATED_ALPHA
            if picture.mode == "RGBA" and is_unassociated and _has_eight_bits(picture):
                upright_picture = ImageOps.exif_transpose(picture)
                return np.ascontiguousarray(np.asarray(upright_picture)[..., :3])
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        # Larger than Pillow's own limit: not checked. (The warning is an exception only where the
        # application turned warnings into errors.)
        refuse_large_image(name, data)
        return None
    except (MemoryError, FormatError):
        raise
    except UnidentifiedImageError as error:
        refuse_large_image(name, data)
        if data.startswith(_PILLOW_SIGNATURES):
            raise FormatError(f"{name} is damaged at its beginning: write it again") from error
        if not data.startswith(_OPENCV_SIGNATURES):
            raise FormatError(
                f"{name} cannot be read as a picture ({len(data)} bytes, starting with "
                f"{data[:8]!r}): it is damaged or of an unknown format; convert it to PNG"
            ) from error
    except Exception as error:  # damaged files make Pillow's decoders raise many kinds of errors
        raise FormatError(f"{name} is cut off or damaged: {error}") from error
    return None


def _has_eight_bits(picture: Image.Image) -> bool:
    """Return whether a TIFF has 8 bits a sample; of 16 bits Pillow would drop the lower 8."""
    return set(getattr(picture, "tag_v2", {}).get(_BITS_PER_SAMPLE, ())) == {8}


@contextlib.contextmanager
def silence_opencv() -> Iterator[None]:
    """Keep OpenCV from printing messages: errors are raised here instead."""
    logging = cv2.utils.logging
    # The log level belongs to the whole process. Without the lock, a thread could save and restore
    # the silent level of another thread instead of the level of the application.
    with _log_level_lock:
        level = logging.getLogLevel()
        logging.setLogLevel(logging.LOG_LEVEL_SILENT)
        try:
            yield
        finally:
            logging.setLogLevel(level)
