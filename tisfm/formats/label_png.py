"""Labels as indexed PNG pictures: a number for every pixel, and a colour for every number."""

import io
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.formats import FormatError, atomic_write


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
        raise ValueError(
            f"labels are {array.shape} {array.dtype}: expected (H, W) of whole numbers"
        )
    if array.size == 0 or array.min() < 0 or array.max() > 255:
        raise ValueError(f"labels of {path} are not within 0 to 255, or there are none")
    picture = Image.fromarray(np.ascontiguousarray(array, np.uint8))
    picture.putpalette(palette().tobytes())
    data = io.BytesIO()
    picture.save(data, format="PNG")
    with atomic_write(path) as file:
        file.write(data.getvalue())


def read_label_png(path: str | os.PathLike[str]) -> NDArray[np.uint8]:
    """Return the labels of an indexed or grey PNG picture, (H, W) uint8.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FormatError
        If it is damaged, or neither indexed nor grey with 8 bits.
    """
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            if picture.mode not in ("P", "L"):
                raise FormatError(
                    f"{path} is of mode {picture.mode}: expected an indexed or grey PNG of 8 bits"
                )
            return np.array(picture, np.uint8)
    except (FileNotFoundError, FormatError):
        raise
    except Exception as error:  # Pillow's decoder raises whatever a damaged file leads it to
        raise FormatError(f"{path} is damaged: it is no PNG picture") from error
