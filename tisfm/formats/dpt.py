"""Depth in Sintel .dpt files."""

import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.formats.tagged import read_tagged, write_tagged


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
        If the tag is wrong, the size absurd, or the file shorter or longer than its header says.
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
    """Write depth to a Sintel .dpt file, whole or not at all.

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
