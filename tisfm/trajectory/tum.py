"""TUM's text of poses with their times: time tx ty tz qx qy qz qw."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.formats import FormatError, atomic_write
from tisfm.trajectory.path import Trajectory, check_poses, check_times
from tisfm.trajectory.rows import read_rows

_UNIT = 1e-2  # of the length of a quaternion: files round to four digits
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
        Of the lines that there are.

    Raises
    ------
    FormatError
        If a line does not hold a pose, or a time does not follow the one before; it is named.
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
    file = Path(path)
    rows = read_rows(file, columns=8)
    last = -np.inf
    for line, numbers in rows:
        if not np.isfinite(numbers).all():
            raise FormatError(f"{file}, line {line} is not finite: leave out frames without a pose")
        length = float(np.linalg.norm(numbers[4:]))
        if abs(length - 1) > _UNIT:
            raise FormatError(
                f"{file}, line {line} has a quaternion of length {length:g}, expected 1: "
                "qx qy qz qw are the last four numbers"
            )
        if not numbers[0] > last:
            raise FormatError(
                f"{file}, line {line} has the time {numbers[0]!r}, expected one after {last!r}"
            )
        last = numbers[0]
    values = np.reshape([numbers for _, numbers in rows], (-1, 8))
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :3] = _rotations(values[:, 4:])
    poses[:, :3, 3] = values[:, 1:4]
    return Trajectory(poses=poses, times=values[:, 0])


def write_tum(path: str | os.PathLike[str], poses: ArrayLike, times: ArrayLike) -> None:
    """Write a text of eight numbers a line: time, s, position and quaternion, camera to world.

    Parameters
    ----------
    path : str or os.PathLike
        Replaced when all is written.
    poses : array_like, shape (N, 4, 4)
        Camera to world. A frame without a pose, NaN, has no line.
    times : array_like, shape (N,)
        Of the frames, s, each above the one before. Where none are known, numbers of frames do.

    Raises
    ------
    ValueError
        If `poses` or `times` are not that.
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
    matrices = check_poses(poses)
    stamps = check_times(times, len(matrices))
    posed = np.isfinite(matrices[:, 0, 0])
    matrices = matrices[posed]
    rows = np.column_stack([stamps[posed], matrices[:, :3, 3], _quaternions(matrices[:, :3, :3])])
    text = "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())
    with atomic_write(path) as file:
        file.write((_HEADING + text).encode())


def _rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, 3, 3) rotations of quaternions x, y, z, w, which need not be of length 1."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    vector, w = unit[:, :3], unit[:, 3, None, None]
    x, y, z = vector.T
    nothing = np.zeros(len(unit))
    cross = np.stack([nothing, -z, y, z, nothing, -x, -y, x, nothing], axis=1).reshape(-1, 3, 3)
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def _quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, 4) quaternions x, y, z, w ≥ 0 of rotations.

    4 q qᵀ is linear in R. Its row of the largest diagonal element is a multiple of q, and no other
    is as far from rounding (Shepperd, Journal of Guidance and Control 1 (1978) 223–224,
    doi 10.2514/3.55767b).
    """
    trace = np.trace(rotations, axis1=1, axis2=2)[:, None, None]
    square = np.empty((len(rotations), 4, 4))
    square[:, :3, :3] = rotations + rotations.transpose(0, 2, 1) + (1 - trace) * np.eye(3)
    square[:, 3, 3] = 1 + trace[:, 0, 0]
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        square[:, 3, k] = square[:, k, 3] = rotations[:, i, j] - rotations[:, j, i]
    largest = np.argmax(np.diagonal(square, axis1=1, axis2=2), axis=1)
    found = square[np.arange(len(rotations)), largest]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return np.where(found[:, 3:] < 0, -found, found)
