"""Trajectories as text files: KITTI's with 12 numbers a line, and TUM's with 8 numbers a line."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.formats import FormatError, atomic_write
from tisfm.formats.reading import read_text
from tisfm.rigid import is_rotation
from tisfm.trajectory.poses import Trajectory, check_poses, check_times


def read_lines(path: Path) -> list[tuple[int, list[str]]]:
    """Return the number and the words of each line that is not empty and no comment (#)."""
    lines = read_text(path).splitlines()
    words = [(number, line.split()) for number, line in enumerate(lines, 1)]
    return [(number, line) for number, line in words if line and not line[0].startswith("#")]


def read_rows(
    path: Path,
    *,
    # Number of values in each line. Empty lines and lines that begin with # are skipped.
    columns: int,
) -> list[tuple[int, list[float]]]:
    """Return the line number and the values of each line of a text file.

    Raises FormatError if a line has other words or another number of values; the message names the
    line.

    Raises OSError if the file does not exist or cannot be read.
    """
    rows = []
    for number, words in read_lines(path):
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise FormatError(f"{path}, line {number}: {error}, expected numbers") from error
        if len(values) != columns:
            raise FormatError(
                f"{path}, line {number} has {len(values)} numbers, expected {columns}"
            )
        rows.append((number, values))
    return rows


def pose_from_rows(numbers: list[float]) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of a pose from its upper three rows."""
    return np.vstack([np.reshape(numbers, (3, 4)), [0, 0, 0, 1]])


def check_pose(pose: NDArray[np.float64], location: str) -> NDArray[np.float64]:
    """Return a (4, 4) pose; raise FormatError, which begins with `location`, if it is not rigid."""
    if not np.isfinite(pose).all():
        raise FormatError(f"{location} is not finite: there is no pose of this frame")
    if not is_rotation(pose[:3, :3]):
        raise FormatError(
            f"{location} is not a rotation: expected an orthonormal matrix in the first three "
            "columns"
        )
    return pose


def read_kitti(path: str | os.PathLike[str]) -> Trajectory:
    """Read a text of twelve numbers a line, the rows of (R | t) from camera to world.

    Parameters
    ----------
    path : str or os.PathLike
        A line for every frame. A line of twelve nan stands for a frame without a pose.

    Returns
    -------
    Trajectory
        Without times.

    Raises
    ------
    FormatError
        If a line is not a pose; the message names the line.
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
        else check_pose(pose_from_rows(numbers), f"{file}, line {line}")
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
        Camera to world. The line of a frame without a pose, NaN, is twelve nan, because the number
        of the line is the number of the frame. Some programs expect a pose on every line: use
        `write_tum` for these.

    Raises
    ------
    ValueError
        If `poses` are not poses.
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


_UNIT_TOLERANCE = 1e-2  # of the length of a quaternion: files round to four digits
_HEADING = "# time tx ty tz qx qy qz qw\n"


def read_tum(path: str | os.PathLike[str]) -> Trajectory:
    """Read a text of eight numbers a line: time, s, position and quaternion, camera to world.

    Parameters
    ----------
    path : str or os.PathLike
        Lines that begin with # do not count. Frames without a pose have no line.

    Returns
    -------
    Trajectory
        The poses and times of the lines.

    Raises
    ------
    FormatError
        If a line is not a pose, or times do not increase; the message names the line.
    OSError
        If the file does not exist or cannot be read.

    References
    ----------
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012,
    doi 10.1109/IROS.2012.6385773.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.trajectory import read_tum, write_tum
    >>> write_tum("path.txt", np.tile(np.eye(4), (3, 1, 1)), times=[0.0, 0.1, 0.2])
    >>> read_tum("path.txt").poses.shape
    (3, 4, 4)
    """
    from scipy.spatial.transform import Rotation  # slow to import

    file = Path(path)
    rows = read_rows(file, columns=8)
    last_time = -np.inf
    for line, numbers in rows:
        if not np.isfinite(numbers).all():
            raise FormatError(f"{file}, line {line} is not finite: leave out frames without a pose")
        length = float(np.linalg.norm(numbers[4:]))
        if abs(length - 1) > _UNIT_TOLERANCE:
            raise FormatError(
                f"{file}, line {line} has a quaternion of length {length:g}, expected 1: "
                "qx qy qz qw are the last four numbers"
            )
        if not numbers[0] > last_time:
            raise FormatError(
                f"{file}, line {line} has the time {numbers[0]!r}, expected one after {last_time!r}"
            )
        last_time = numbers[0]
    values = np.reshape([numbers for _, numbers in rows], (-1, 8))
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(values[:, 4:]).as_matrix()
    poses[:, :3, 3] = values[:, 1:4]
    return Trajectory(poses=poses, times=values[:, 0])


def write_tum(
    path: str | os.PathLike[str], poses: ArrayLike, times: ArrayLike, *, note: str = ""
) -> None:
    """Write a text of eight numbers a line: time, s, position and quaternion, camera to world.

    Parameters
    ----------
    path : str or os.PathLike
        Replaced when all is written.
    poses : array_like, shape (N, 4, 4)
        Camera to world. A frame without a pose, NaN, has no line.
    times : array_like, shape (N,)
        Times of the frames, s, increasing. Numbers of frames may stand for unknown times.
    note : str, optional
        A text that is written as a comment, which readers skip.

    Raises
    ------
    ValueError
        If `poses` or `times` have other shapes or values.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.trajectory import read_tum, write_tum
    >>> write_tum("path.txt", np.tile(np.eye(4), (3, 1, 1)), times=[0.0, 0.1, 0.2])
    >>> read_tum("path.txt").times.tolist()
    [0.0, 0.1, 0.2]
    """
    from scipy.spatial.transform import Rotation  # slow to import

    matrices = check_poses(poses)
    checked_times = check_times(times, len(matrices))
    has_pose = np.isfinite(matrices[:, 0, 0])
    matrices = matrices[has_pose]
    quaternions = Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
    quaternions[quaternions[:, 3] < 0] *= -1  # q and -q are one rotation: write qw ≥ 0
    rows = np.column_stack([checked_times[has_pose], matrices[:, :3, 3], quaternions])
    text = "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())
    comment = f"# {' '.join(note.split())}\n" if note else ""
    with atomic_write(path) as file:
        file.write((_HEADING + comment + text).encode())


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a file in the format of TUM or of KITTI, which is recognised by its first line.

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
        If the file is of neither format, or a line is not a pose; the message names the line.
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
            f"{file} is not a trajectory: its first line has {count} words, expected 8 numbers "
            "(TUM: time tx ty tz qx qy qz qw) or 12 (KITTI: the rows of R | t)"
        )
    return read_tum(file) if count == 8 else read_kitti(file)
