"""Pictures whose values are labels: indexed or grey."""

import io
import os

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.formats.completeness import missing_part
from tisfm.formats.errors import FormatError
from tisfm.formats.images import PILLOW_FORMATS
from tisfm.formats.reading import read_bytes


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
    data = read_bytes(name)
    missing = missing_part(data)
    if missing is not None:
        raise FormatError(f"{name} is cut off after {len(data)} bytes: {missing} is missing")
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
