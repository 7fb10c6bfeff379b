"""Files of camera poses, and the motion between two poses."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.formats import FormatError
from tisfm.trajectory.text_files import check_pose, pose_from_rows, read_rows


def read_pose(
    path: Path,  # text of four rows of four numbers, camera to world
) -> NDArray[np.float64]:  # (4, 4) float64 ndarray
    """Read a camera pose from a file that holds this pose alone.

    Raises FormatError if the file is not a pose, or has values that are not finite.

    Raises OSError if the file does not exist or cannot be read.
    """
    rows = [numbers for _, numbers in read_rows(path, columns=4)]
    if len(rows) != 4:
        raise FormatError(f"{path} has {len(rows)} rows of numbers, expected a 4 × 4 matrix")
    pose = np.array(rows)
    if np.isfinite(pose).all() and not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise FormatError(f"{path} has the last row {pose[3].tolist()}, expected 0 0 0 1")
    return check_pose(pose, str(path))


def read_pose_row(
    # text of twelve numbers a row: the upper three rows of a 4 × 4 matrix, camera to world
    path: Path,
    row: int,  # number of the row, from 0
) -> NDArray[np.float64]:  # (4, 4) float64 ndarray
    """Read a camera pose from a file with one row for each frame.

    Raises FormatError if a row of the file does not have twelve numbers, or this row is missing or
    not a pose.

    Raises OSError if the file does not exist or cannot be read.
    """
    rows = [numbers for _, numbers in read_rows(path, columns=12)]
    if row >= len(rows):
        raise FormatError(
            f"{path} has {len(rows)} rows, so there is no pose of frame {row}: expected a row for "
            "every frame, from 0"
        )
    return check_pose(pose_from_rows(rows[row]), f"{path}, row {row}")


def read_poses(
    # Text with a line of twelve numbers for every frame, as in KITTI's odometry: the upper three
    # rows of a 4 × 4 matrix, camera to world. Empty lines are skipped.
    path: Path,
) -> list[NDArray[np.float64]]:  # list of (4, 4) float64 ndarray
    """Read the poses of all frames of a sequence.

    Raises FormatError if a line is not a pose; the message names the line.

    Raises OSError if the file does not exist or cannot be read.
    """
    return [
        check_pose(pose_from_rows(numbers), f"{path}, line {line}")
        for line, numbers in read_rows(path, columns=12)
    ]


def motion_between(
    # first_pose, second_pose: (4, 4) ndarray, poses, camera to world
    first_pose: NDArray[np.float64],
    second_pose: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the motion of a static scene relative to a camera that moves between two poses.

    Returns (4, 4) float64, which takes points from the axes of the first camera to the axes of the
    second.
    """
    motion: NDArray[np.float64] = np.linalg.inv(second_pose) @ first_pose
    motion[3] = 0, 0, 0, 1  # exactly, without rounding errors
    return motion
