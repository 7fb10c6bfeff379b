"""Pictures whose values are labels: indexed or grey."""

import io
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.errors import InputError
from tisfm.formats.atomic import atomic_write
from tisfm.formats.image_headers import PILLOW_FORMATS, missing_part
from tisfm.formats.reading import FormatError, read_bytes


def read_label_picture(path: str | os.PathLike[str]) -> NDArray[np.uint8]:
    """Read the labels of pixels: indices of a palette, whatever its colours, or grey levels.

    Parameters
    ----------
    path : str or os.PathLike
        File to read: an indexed or grey picture of at most 8 bits, or a coloured one that is grey.

    Returns
    -------
    (H, W) uint8 ndarray

    Raises
    ------
    FormatError
        If the file is damaged, not a picture, or has more bits or colours.
    OSError
        If the file does not exist or cannot be read.
    """
    name = os.fspath(path)
    data = _whole(name)
    try:
        with Image.open(io.BytesIO(data), formats=PILLOW_FORMATS) as picture:
            picture.load()
            kind, values = picture.mode, np.asarray(picture)
    except MemoryError:
        raise
    except Exception as error:  # Pillow's decoder raises whatever a damaged file leads it to
        raise FormatError(f"{name} cannot be read as a picture of labels: {error}") from error
    if kind == "RGB" and (values == values[..., :1]).all():
        return np.ascontiguousarray(values[..., 0])
    if kind not in ("1", "L", "P"):
        raise FormatError(
            f"{name} is a picture of mode {kind}: expected labels, indexed or grey of 8 bits"
        )
    return values.astype(np.uint8)


def has_palette_of_labels(path: str | os.PathLike[str]) -> bool:
    """Return whether a picture is indexed, with colours in its palette, as labels mostly are.

    A picture of grey levels is not, though it may be indexed.

    Raises
    ------
    FormatError
        If it is not a picture.
    OSError
        If the file does not exist or cannot be read.
    """
    name = os.fspath(path)
    data = _whole(name)
    try:
        with Image.open(io.BytesIO(data), formats=PILLOW_FORMATS) as picture:
            colours = picture.getpalette("RGB") if picture.mode == "P" else None
    except MemoryError:
        raise
    except Exception as error:  # Pillow's decoder raises whatever a damaged file leads it to
        raise FormatError(f"{name} cannot be read as a picture: {error}") from error
    table = np.array(colours or [0, 0, 0]).reshape(-1, 3)
    return bool((table != table[:, :1]).any())


def _whole(name: str) -> bytes:
    """Return the bytes of a picture, FormatError if some are missing by its own account."""
    data = read_bytes(name)
    missing = missing_part(data)
    if missing is not None:
        raise FormatError(f"{name} is cut off after {len(data)} bytes: {missing} is missing")
    return data


def palette() -> NDArray[np.uint8]:
    """Return the colours of labels 0 to 255, (256, 3) uint8 RGB.

    They are those of PASCAL VOC and DAVIS: bits of the label, in turn from the lowest, are the
    highest that are left of red, green and blue.
    """
    label, colours = np.arange(256), np.zeros((256, 3), np.uint8)
    for place in range(8):
        for channel in range(3):
            colours[:, channel] |= ((label >> channel & 1) << (7 - place)).astype(np.uint8)
        label = label >> 3
    return colours


def write_label_png(path: str | os.PathLike[str], labels: NDArray[Any]) -> None:
    """Write labels as an indexed PNG picture, whole or not at all.

    Parameters
    ----------
    path : path
    labels : (H, W) int array
        From 0 to 255.

    Raises
    ------
    ValueError
        If they are of another shape or kind, or not within 0 to 255.
    OSError
        If the file cannot be written.
    """
    array = np.asarray(labels)
    if array.ndim != 2 or array.dtype.kind not in "biu":
        raise InputError(
            f"labels are {array.shape} {array.dtype}: expected (H, W) of whole numbers"
        )
    if array.size == 0 or array.min() < 0 or array.max() > 255:
        raise InputError(f"labels of {path} are not within 0 to 255, or there are none")
    picture = Image.fromarray(np.ascontiguousarray(array, np.uint8))
    picture.putpalette(palette().tobytes())
    data = io.BytesIO()
    picture.save(data, format="PNG")
    with atomic_write(path) as file:
        file.write(data.getvalue())
