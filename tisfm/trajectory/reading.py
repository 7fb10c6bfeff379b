"""Trajectories of either format."""

import os
from pathlib import Path

from tisfm.formats import FormatError
from tisfm.trajectory.kitti import read_kitti
from tisfm.trajectory.path import Trajectory
from tisfm.trajectory.rows import read_lines
from tisfm.trajectory.tum import read_tum


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a file in the format of TUM or of KITTI, whichever it is.

    Parameters
    ----------
    path : str or os.PathLike
        Text of 8 numbers a line, as `read_tum` takes it, or of 12, as `read_kitti` does.

    Returns
    -------
    Trajectory

    Raises
    ------
    FormatError
        If it is of neither format, or a line holds no pose; the line is named.
    OSError
        If the file does not exist or cannot be read.

    Examples
    --------
    >>> from tisfm.trajectory import read_trajectory
    >>> read_trajectory("calibrated/poses.txt").poses.shape
    (9, 4, 4)
    """
    file = Path(path)
    lines = read_lines(file)
    count = len(lines[0][1]) if lines else 0
    if count not in (8, 12):
        raise FormatError(
            f"{file} is no trajectory: its first line has {count} words, expected 8 numbers (TUM: "
            "time tx ty tz qx qy qz qw) or 12 (KITTI: the rows of R | t)"
        )
    return read_tum(file) if count == 8 else read_kitti(file)
