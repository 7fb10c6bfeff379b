"""The poses of a camera along a sequence, with the times of the frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.rigid import is_rotation


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """The poses of a sequence of frames.

    Attributes
    ----------
    poses : (N, 4, 4) float64 ndarray
        Camera to world; NaN for a frame without a pose.
    times : (N,) float64 ndarray or None
        Times of the frames, s, each later than the one before; None if unknown.

    Raises
    ------
    ValueError
        If `poses` or `times` has other shapes or values.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.trajectory import Trajectory
    >>> poses = np.tile(np.eye(4), (3, 1, 1))
    >>> poses[1] = np.nan  # no pose
    >>> Trajectory(poses=poses, times=[0.0, 0.1, 0.2]).posed.tolist()
    [True, False, True]
    """

    poses: NDArray[np.float64]
    times: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Check poses and times."""
        object.__setattr__(self, "poses", check_poses(self.poses))
        if self.times is not None:
            object.__setattr__(self, "times", check_times(self.times, len(self.poses)))

    @property
    def posed(self) -> NDArray[np.bool_]:
        """Which frames have a pose, (N,)."""
        return np.asarray(np.isfinite(self.poses[:, 0, 0]))


def check_poses(
    # array_like, shape (N, 4, 4): camera to world; a matrix with any NaN stands for a missing pose
    poses: ArrayLike,
) -> NDArray[np.float64]:  # (N, 4, 4) float64 ndarray: all NaN for a missing pose
    """Return poses as float64; raise ValueError unless each is a rigid motion, or has NaN."""
    array = check_unmasked(poses, "poses", np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise InputError(f"poses are {array.shape}: expected (N, 4, 4)")
    is_missing = np.isnan(array).any(axis=(1, 2))
    for index in np.flatnonzero(~is_missing):
        pose = array[index]
        if not np.isfinite(pose).all() or not is_rotation(pose[:3, :3]):
            raise InputError(
                f"poses[{index}] is {pose.tolist()}: expected a rotation and a translation, or NaN"
            )
    return np.where(is_missing[:, None, None], np.nan, array)


def check_times(times: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return times as float64; raise ValueError unless they are `count` increasing numbers."""
    array = check_unmasked(times, "times", np.float64)
    if array.shape != (count,):
        raise InputError(f"times are {array.shape}: expected ({count},), one for every pose")
    not_later = np.flatnonzero(~(np.diff(array) > 0))
    if not np.isfinite(array).all() or len(not_later):
        index = int(not_later[0]) + 1 if len(not_later) else 0
        raise InputError(
            f"times[{index}] is {array[index]}: expected finite numbers, each above the one before"
        )
    return array
