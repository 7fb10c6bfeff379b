"""Optical flow in Middlebury .flo files."""

import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.formats.tagged import LARGEST_SIDE, read_tagged, write_tagged


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
    """Raise ValueError unless a .flo file can hold the flow of a frame, by its name and size."""
    if max(height, width) > LARGEST_SIDE:
        raise ValueError(
            f"{name} is {height} × {width} px, but its flow goes into a .flo file, whose sides are "
            f"at most {LARGEST_SIDE} px: scale the frames down"
        )
