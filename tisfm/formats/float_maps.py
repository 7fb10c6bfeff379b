"""Flow in Middlebury .flo files and depth in Sintel .dpt files.

Both have the same layout: a tag, width and height, and float32 values.
"""

import os
import struct

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.formats.atomic import atomic_write
from tisfm.formats.reading import FormatError, read_bytes

TAG = 202021.25
"""First float32 of .flo, .dpt and Sintel's .cam files, by which readers check the type of the file
and the byte order. Its little-endian bytes read "PIEH"."""

MAX_SIDE = 99_999
"""Largest width and height, px. Middlebury's readers of .flo files and Sintel's readers of .dpt
files treat a larger side as a damaged header."""

_TAG = struct.pack("<f", TAG)
_HEADER = struct.Struct("<4sii")  # tag, width, height


def read_tagged(
    path: str | os.PathLike[str],  # file to read
    *,
    suffix: str,  # suffix of such files, such as ".flo", for messages
    channels: int,  # values per pixel
) -> NDArray[np.float32]:  # (H, W, channels) float32 ndarray: values as stored
    """Read a file with a tag, int32 width and height, and float32 values, the top row first.

    Raises FormatError if the tag is wrong, a side is not from 1 to 99999, or the file is shorter or
    longer than its header says.

    Raises OSError if the file does not exist or cannot be read.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    if data[:4] != _TAG[: len(data)]:
        order_note = ", it was written big-endian" if data[:4] == _TAG[::-1] else ""
        raise FormatError(
            f"{name} is not a {suffix} file: it starts with {data[:4]!r}, expected {_TAG!r}"
            f"{order_note}"
        )
    if len(data) < _HEADER.size:
        raise FormatError(
            f"{name} is cut off in its header: {len(data)} of {_HEADER.size} bytes are there"
        )
    _, width, height = _HEADER.unpack_from(data)
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise FormatError(
            f"{name} has an impossible size in its header: width {width}, height {height}, "
            f"expected 1 to {MAX_SIDE}"
        )
    expected = _HEADER.size + 4 * channels * width * height
    if len(data) != expected:
        fault = "cut off" if len(data) < expected else "too long"
        raise FormatError(
            f"{name} is {fault}: {len(data)} bytes, expected {expected} for {width} x {height} px; "
            "copy or download it again"
        )
    values = np.frombuffer(data, dtype="<f4", offset=_HEADER.size)
    return values.astype(np.float32).reshape(height, width, channels)


def write_tagged(
    path: str | os.PathLike[str],  # file to write
    name: str,  # name of the values in messages
    # (H, W) or (H, W, channels) array_like of real numbers: values, stored as float32; (H, W) for
    # one channel
    values: ArrayLike,
    *,
    channels: int,  # values per pixel
) -> None:
    """Write a file as `read_tagged` reads it; after an error there is no incomplete file.

    Raises ValueError if `values` has another shape, a side is not from 1 to 99999, or a value is
    masked.

    Raises TypeError if `values` does not hold real numbers.

    Raises OSError if the file cannot be written.
    """
    array = check_real_numbers(name, values)
    channel_shape = (channels,) if channels > 1 else ()
    has_valid_size = all(1 <= side <= MAX_SIDE for side in array.shape[:2])
    if (
        array.ndim != 2 + len(channel_shape)
        or array.shape[2:] != channel_shape
        or not has_valid_size
    ):
        shape = f"(H, W, {channels})" if channel_shape else "(H, W)"
        raise InputError(
            f"{name} is {array.shape}, expected {shape} with H and W from 1 to {MAX_SIDE}"
        )
    height, width = array.shape[:2]
    with atomic_write(path) as file:
        file.write(_HEADER.pack(_TAG, width, height))
        file.write(np.ascontiguousarray(array, "<f4").data)


def check_real_numbers(name: str, values: ArrayLike) -> NDArray[np.generic]:
    """Return an array of real numbers without a mask, or raise an error that names it."""
    array = check_unmasked(values, name)
    if array.dtype.kind not in "iuf":
        raise InputTypeError(
            f"{name} has dtype {array.dtype}, expected real numbers, such as float32"
        )
    return array


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
        If the tag is wrong, a side is not from 1 to 99999, or the file is shorter or longer than
        its header says.
    OSError
        If the file does not exist or cannot be read.

    References
    ----------
    S. Baker et al., "A database and evaluation methodology for optical flow", International
    Journal of Computer Vision 92 (2011) 1-31, doi:10.1007/s11263-010-0390-2.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_flo, write_flo
    >>> flow = np.zeros((48, 64, 2), np.float32)
    >>> flow[0, 0] = np.nan  # unknown
    >>> write_flo("still.flo", flow)
    >>> int(np.isnan(read_flo("still.flo")).any(axis=-1).sum())
    1
    """
    return read_tagged(path, suffix=".flo", channels=2)


def write_flo(path: str | os.PathLike[str], flow: ArrayLike) -> None:
    """Write a flow field to a Middlebury .flo file; after an error there is no incomplete file.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    flow : (H, W, 2) array_like of real numbers
        Flow (u, v), px, stored as float32. The format marks unknown flow by values beyond 1e9; NaN
        is stored as NaN.

    Raises
    ------
    ValueError
        If `flow` is not (H, W, 2) with 1 to 99999 rows and columns, or a value is masked.
    TypeError
        If `flow` does not hold real numbers.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_flo, write_flo
    >>> write_flo("still.flo", np.zeros((48, 64, 2), np.float32))  # (u, v), px
    >>> read_flo("still.flo").shape
    (48, 64, 2)
    """
    write_tagged(path, "flow", flow, channels=2)


def require_writable_flow(name: str, height: int, width: int) -> None:
    """Raise ValueError if the frame `name` is too large for a .flo file of its flow."""
    if max(height, width) > MAX_SIDE:
        raise InputError(
            f"{name} is {height} × {width} px, but its flow goes into a .flo file, whose sides are "
            f"at most {MAX_SIDE} px: scale the frames down"
        )


def read_dpt(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read depth from a Sintel .dpt file.

    Parameters
    ----------
    path : str or os.PathLike
        File to read.

    Returns
    -------
    (H, W) float32 ndarray
        Depth as stored; Sintel's is in metres.

    Raises
    ------
    FormatError
        If the tag is wrong, a side is not from 1 to 99999, or the file is shorter or longer than
        its header says.
    OSError
        If the file does not exist or cannot be read.

    References
    ----------
    D. J. Butler et al., "A naturalistic open source movie for optical flow evaluation", ECCV 2012,
    611-625, doi:10.1007/978-3-642-33783-3_44.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_dpt, write_dpt
    >>> write_dpt("depth.dpt", np.array([[2.5, 4.0]], np.float32))
    >>> read_dpt("depth.dpt").tolist()
    [[2.5, 4.0]]
    """
    return read_tagged(path, suffix=".dpt", channels=1)[..., 0]


def write_dpt(path: str | os.PathLike[str], depth: ArrayLike) -> None:
    """Write depth to a Sintel .dpt file; after an error there is no incomplete file.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    depth : (H, W) array_like of real numbers
        Depth in any unit, stored as float32. The format has no mark for unknown depth: NaN and
        infinity are stored as they are.

    Raises
    ------
    ValueError
        If `depth` is not (H, W) with 1 to 99999 rows and columns, or a value is masked.
    TypeError
        If `depth` does not hold real numbers.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_dpt, write_dpt
    >>> write_dpt("depth.dpt", np.full((48, 64), 2.5, np.float32))
    >>> read_dpt("depth.dpt").shape
    (48, 64)
    """
    write_tagged(path, "depth", depth, channels=1)
