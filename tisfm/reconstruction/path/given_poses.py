"""Assignment of given poses to frames: by times, or else by order."""

from collections.abc import Sequence

import numpy as np

from tisfm.checks import check_pose_count
from tisfm.errors import InputError
from tisfm.status import Status
from tisfm.trajectory import Trajectory
from tisfm.trajectory.times import are_increasing, associate

# Largest time from a frame to its pose, as a share of the median interval between frames.
MAX_TIME_SHARE = 0.5


def poses_of_frames(
    given: Trajectory,
    times: Sequence[float | None],  # times of the frames, s; None if unknown
) -> tuple[np.ndarray, dict[int, Status]]:
    """Return a pose for each frame, NaN if it has none, and the reasons for missing poses.

    If poses and all frames have times, each frame gets the pose nearest in time. If not, poses
    belong to the frames in their order.

    Returns poses, (N, 4, 4) float64, camera to world; and the reason for each frame without a pose.

    Raises ValueError if poses are assigned by order, and their number differs from the number of
    frames; or if no pose is near a frame in time.
    """
    reason = "no pose is given for it"
    if given.times is None or len(times) < 2 or not are_increasing(times):
        check_poses_count(given, len(times))
        poses = given.poses
    else:
        seconds = np.array(times, np.float64)
        max_time = MAX_TIME_SHARE * float(np.median(np.diff(seconds)))
        frames, indices = associate(seconds, given.times, farthest=max_time)
        if not len(frames):
            raise InputError(
                f"no pose is within {max_time:.3g} s of a frame: frames are from {seconds[0]:.3f} "
                f"to {seconds[-1]:.3f} s, poses from {given.times[0]:.3f} to "
                f"{given.times[-1]:.3f} s; give poses with the times of the frames, or one pose "
                "for each frame in order, without times (KITTI's format)"
            )
        poses = np.full((len(seconds), 4, 4), np.nan)
        poses[frames] = given.poses[indices]
        reason = f"no pose is given within {max_time:.3g} s of it"
    missing = np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2))).tolist()
    return poses, dict.fromkeys(missing, Status("unrelated", reason))


def check_poses_count(given: Trajectory, count: int) -> None:
    """Raise ValueError unless there are as many poses as frames."""
    if given.times is not None and len(given.poses) != count:
        raise InputError(
            f"poses are {len(given.poses)} with times, but the {count} frames have no times "
            "that increase: expected one pose for each frame, or times for all frames"
        )
    check_pose_count(len(given.poses), count)
