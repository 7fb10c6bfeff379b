"""Images whose pixel values are labels: indices of a palette, or grey levels."""

import io
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.errors import InputError
from tisfm.formats.atomic import atomic_write
from tisfm.formats.image_headers import PILLOW_FORMATS, find_missing_part
from tisfm.formats.reading import FormatError, read_bytes


def read_label_picture(
    # file to read: an indexed or grey image of at most 8 bits, or an RGB image whose three channels
    # are equal
    path: str | os.PathLike[str],
) -> NDArray[np.uint8]:  # (H, W) uint8 ndarray
    """Read the labels of pixels: indices of a palette of any colours, or grey levels.

    Raises FormatError if the file is damaged, or is not such an image.

    Raises OSError if the file does not exist or cannot be read.
    """
    name = os.fspath(path)
    data = _read_complete(name)
    try:
        with Image.open(io.BytesIO(data), formats=PILLOW_FORMATS) as picture:
            picture.load()
            mode, values = picture.mode, np.asarray(picture)
    except MemoryError:
        raise
    except Exception as error:  # damaged files make Pillow's decoder raise many kinds of errors
        raise FormatError(f"{name} cannot be read as a picture of labels: {error}") from error
    if mode == "RGB" and (values == values[..., :1]).all():
        return np.ascontiguousarray(values[..., 0])
    if mode not in ("1", "L", "P"):
        raise FormatError(
            f"{name} is a picture of mode {mode}: expected labels, indexed or grey of 8 bits"
        )
    return values.astype(np.uint8)


def has_colour_palette(path: str | os.PathLike[str]) -> bool:
    """Return whether an image is indexed and its palette has colours other than grey.

    Most images of labels do; an indexed image of grey levels does not.

    Raises FormatError if the file is not an image.

    Raises OSError if the file does not exist or cannot be read.
    """
    name = os.fspath(path)
    data = _read_complete(name)
    try:
        with Image.open(io.BytesIO(data), formats=PILLOW_FORMATS) as picture:
            colours = picture.getpalette("RGB") if picture.mode == "P" else None
    except MemoryError:
        raise
    except Exception as error:  # damaged files make Pillow's decoder raise many kinds of errors
        raise FormatError(f"{name} cannot be read as a picture: {error}") from error
    table = np.array(colours or [0, 0, 0]).reshape(-1, 3)
    return bool((table != table[:, :1]).any())


def _read_complete(name: str) -> bytes:
    """Return the bytes of an image file; FormatError if it is shorter than it states."""
    data = read_bytes(name)
    missing_part = find_missing_part(data)
    if missing_part is not None:
        raise FormatError(f"{name} is cut off after {len(data)} bytes: {missing_part} is missing")
    return data


def label_colours() -> NDArray[np.uint8]:
    """Return the colours of labels 0 to 255, (256, 3) uint8 RGB.

    They are the colours of PASCAL VOC and DAVIS: the lowest three bits of the label are the highest
    bits of red, green and blue, the next three bits the second highest, and so on.
    """
    label, colours = np.arange(256), np.zeros((256, 3), np.uint8)
    for bit in range(8):
        for channel in range(3):
            colours[:, channel] |= ((label >> channel & 1) << (7 - bit)).astype(np.uint8)
        label = label >> 3
    return colours


def write_label_png(
    path: str | os.PathLike[str],
    labels: NDArray[Any],  # (H, W) int array: from 0 to 255
) -> None:
    """Write labels as an indexed PNG image; after an error there is no incomplete file.

    Raises ValueError if `labels` has another shape or type, or values outside 0 to 255.

    Raises OSError if the file cannot be written.
    """
    array = np.asarray(labels)
    if array.ndim != 2 or array.dtype.kind not in "biu":
        raise InputError(f"labels are {array.shape} {array.dtype}: expected (H, W) integers")
    if array.size == 0 or array.min() < 0 or array.max() > 255:
        raise InputError(f"labels of {path} are empty or not within 0 to 255: expected 0 to 255")
    picture = Image.fromarray(np.ascontiguousarray(array, np.uint8))
    picture.putpalette(label_colours().tobytes())
    data = io.BytesIO()
    picture.save(data, format="PNG")
    with atomic_write(path) as file:
        file.write(data.getvalue())
