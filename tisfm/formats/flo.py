"""Optical flow in Middlebury .flo files."""

import os
import struct

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.formats.atomic import atomic_write
from tisfm.formats.errors import FormatError
from tisfm.formats.reading import read_bytes

# The float32 202021.25, whose little-endian bytes read "PIEH": a check of type and byte order.
_TAG = struct.pack("<f", 202021.25)
_HEADER = struct.Struct("<4sii")
# Beyond this a size is the sign of a damaged header, not of a picture.
_LARGEST_SIDE = 99_999


def read_flo(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read a flow field from a Middlebury .flo file.

    Parameters
    ----------
    path : str or os.PathLike
        File to read.

    Returns
    -------
    (H, W, 2) float32 ndarray
        Flow (u, v), px. Unknown flow is stored as values beyond 1e9 and returned as stored.

    Raises
    ------
    FormatError
        If the tag is wrong, the size absurd, or the file shorter or longer than its header says.
    OSError
        If the file does not exist or cannot be read.

    References
    ----------
    S. Baker et al., "A database and evaluation methodology for optical flow", International
    Journal of Computer Vision 92 (2011) 1-31, doi:10.1007/s11263-010-0390-2.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    if data[:4] != _TAG[: len(data)]:
        order = ", it was written big-endian" if data[:4] == _TAG[::-1] else ""
        raise FormatError(
            f"{name} is not a .flo file: it starts with {data[:4]!r}, expected {_TAG!r}{order}"
        )
    if len(data) < _HEADER.size:
        raise FormatError(
            f"{name} is cut off in its header: {len(data)} of {_HEADER.size} bytes are there"
        )
    _, width, height = _HEADER.unpack_from(data)
    if not (1 <= width <= _LARGEST_SIDE and 1 <= height <= _LARGEST_SIDE):
        raise FormatError(
            f"{name} has an impossible size in its header: width {width}, height {height}, "
            f"expected 1 to {_LARGEST_SIDE}"
        )
    expected = _HEADER.size + 8 * width * height
    if len(data) != expected:
        fault = "cut off" if len(data) < expected else "too long"
        raise FormatError(
            f"{name} is {fault}: {len(data)} bytes, expected {expected} for {width} x {height} px"
        )
    values = np.frombuffer(data, dtype="<f4", offset=_HEADER.size)
    return values.astype(np.float32).reshape(height, width, 2)


def write_flo(path: str | os.PathLike[str], flow: ArrayLike) -> None:
    """Write a flow field to a Middlebury .flo file, whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    flow : (H, W, 2) array_like of real numbers
        Flow (u, v), px, stored as float32. The format marks unknown flow by values beyond 1e9;
        nothing is translated here.

    Raises
    ------
    ValueError
        If `flow` is not (H, W, 2) with 1 to 99999 rows and columns.
    TypeError
        If `flow` does not hold real numbers.
    OSError
        If the file cannot be written.
    """
    values = np.asarray(flow)
    if values.dtype.kind not in "iuf":
        raise TypeError(f"flow has dtype {values.dtype}, expected real numbers, such as float32")
    sides = values.shape[:2]
    if values.ndim != 3 or values.shape[2] != 2 or not all(1 <= n <= _LARGEST_SIDE for n in sides):
        raise ValueError(
            f"flow is {values.shape}, expected (H, W, 2) with H and W from 1 to {_LARGEST_SIDE}"
        )
    height, width = sides
    with atomic_write(path) as file:
        file.write(_HEADER.pack(_TAG, width, height))
        file.write(values.astype("<f4").tobytes())
