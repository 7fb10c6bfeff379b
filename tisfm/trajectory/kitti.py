"""KITTI's text of poses: a row for every frame."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tisfm.formats import atomic_write
from tisfm.trajectory.path import Trajectory, check_poses
from tisfm.trajectory.rows import checked_pose, pose_of_twelve, read_rows


def read_kitti(path: str | os.PathLike[str]) -> Trajectory:
    """Read a text of twelve numbers a line, the rows of (R | t) from camera to world.

    Parameters
    ----------
    path : str or os.PathLike
        A line for every frame. One of twelve nan stands for a frame without a pose.

    Returns
    -------
    Trajectory
        Without times.

    Raises
    ------
    FormatError
        If a line does not hold a pose; it is named.
    OSError
        If the file does not exist or cannot be read.

    References
    ----------
    Geiger, Lenz and Urtasun, Are we ready for autonomous driving?, CVPR 2012,
    doi 10.1109/CVPR.2012.6248074: the files of its odometry benchmark.

    Examples
    --------
    >>> from tisfm.trajectory import read_kitti
    >>> read_kitti("calibrated/poses.txt").times is None
    True
    """
    file = Path(path)
    poses = [
        np.full((4, 4), np.nan)
        if np.isnan(numbers).all()
        else checked_pose(pose_of_twelve(numbers), f"{file}, line {line}")
        for line, numbers in read_rows(file, columns=12)
    ]
    return Trajectory(poses=np.reshape(poses, (-1, 4, 4)))


def write_kitti(path: str | os.PathLike[str], poses: ArrayLike) -> None:
    """Write a text of twelve numbers a line, the rows of (R | t) from camera to world.

    Parameters
    ----------
    path : str or os.PathLike
        Replaced when all is written.
    poses : array_like, shape (N, 4, 4)
        Camera to world. A frame without a pose, NaN, has a line of twelve nan, because lines are
        counted. Programs that expect a pose on every line stop there: give them `write_tum`'s.

    Raises
    ------
    ValueError
        If `poses` are none.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.trajectory import read_kitti, write_kitti
    >>> poses = np.tile(np.eye(4), (3, 1, 1))
    >>> poses[1] = np.nan  # no pose
    >>> write_kitti("poses.txt", poses)
    >>> read_kitti("poses.txt").posed.tolist()
    [True, False, True]
    """
    rows = check_poses(poses)[:, :3].reshape(-1, 12)
    text = "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())
    with atomic_write(path) as file:
        file.write(text.encode())
