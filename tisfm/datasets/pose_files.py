"""Poses of cameras along a sequence, and the motion from one frame to another."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.formats import FormatError
from tisfm.trajectory.text_files import checked_pose, pose_of_twelve, read_rows


def read_pose(path: Path) -> NDArray[np.float64]:
    """Read the pose of one camera from a file of its own.

    Parameters
    ----------
    path : Path
        Text of four rows of four numbers, camera to world.

    Returns
    -------
    (4, 4) float64 ndarray

    Raises
    ------
    FormatError
        If the file does not hold a pose, or one that is not finite.
    OSError
        If the file does not exist or cannot be read.
    """
    rows = [numbers for _, numbers in read_rows(path, columns=4)]
    if len(rows) != 4:
        raise FormatError(f"{path} has {len(rows)} rows of numbers, expected a 4 × 4 matrix")
    pose = np.array(rows)
    if np.isfinite(pose).all() and not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise FormatError(f"{path} has the last row {pose[3].tolist()}, expected 0 0 0 1")
    return checked_pose(pose, str(path))


def read_pose_row(path: Path, row: int) -> NDArray[np.float64]:
    """Read the pose of one camera from a file that has a row for each.

    Parameters
    ----------
    path : Path
        Text of twelve numbers a row: the upper three rows of a 4 × 4 matrix, camera to world.
    row : int
        Which row, from 0.

    Returns
    -------
    (4, 4) float64 ndarray

    Raises
    ------
    FormatError
        If a row of the file does not have twelve numbers, or the one asked for is missing or
        holds no pose.
    OSError
        If the file does not exist or cannot be read.
    """
    rows = [numbers for _, numbers in read_rows(path, columns=12)]
    if row >= len(rows):
        raise FormatError(
            f"{path} has {len(rows)} rows, so there is no pose of frame {row}: expected a row for "
            "every frame, from 0"
        )
    return checked_pose(pose_of_twelve(rows[row]), f"{path}, row {row}")


def read_poses(path: Path) -> list[NDArray[np.float64]]:
    """Read the poses of all frames of a sequence.

    Parameters
    ----------
    path : Path
        Text of twelve numbers a line, one for every frame, as KITTI's odometry has it: the upper
        three rows of a 4 × 4 matrix, camera to world. Empty lines do not count.

    Returns
    -------
    list of (4, 4) float64 ndarray

    Raises
    ------
    FormatError
        If a line does not hold a pose; it is named.
    OSError
        If the file does not exist or cannot be read.
    """
    return [
        checked_pose(pose_of_twelve(numbers), f"{path}, line {line}")
        for line, numbers in read_rows(path, columns=12)
    ]


def motion_between(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the motion of a scene at rest, as seen by a camera that goes from one pose to another.

    Parameters
    ----------
    first, second : (4, 4) ndarray
        Poses, camera to world.

    Returns
    -------
    (4, 4) float64 ndarray
        Takes points in the axes of the first camera to the axes of the second.
    """
    motion: NDArray[np.float64] = np.linalg.inv(second) @ first
    motion[3] = 0, 0, 0, 1  # but for rounding
    return motion
