"""Assignment of given poses to frames: by times, or else by order."""

from collections.abc import Sequence

import numpy as np

from tisfm.checks import check_pose_count
from tisfm.errors import InputError
from tisfm.status import Status
from tisfm.trajectory import Trajectory
from tisfm.trajectory.times import are_increasing, associate

# Largest time from a frame to its pose, as a share of the median interval between frames. Half an
# interval: a pose that is farther away belongs to another frame.
MAX_TIME_SHARE = 0.5


def find_frame_poses(
    trajectory: Trajectory,
    times: Sequence[float | None],  # times of the frames, s; None if unknown
) -> tuple[np.ndarray, dict[int, Status]]:
    """Return a pose for each frame, NaN for a frame without a pose, and the reasons for NaN.

    If poses and all frames have times, each frame gets the pose nearest in time. Otherwise poses
    belong to frames by their order.

    Returns poses, (N, 4, 4) float64, camera to world; and the reason for each frame without a pose.

    Raises InputError if poses are assigned by order, and their number differs from the number of
    frames; or if no pose is near a frame in time.
    """
    reason = "no pose is given for it"
    if trajectory.times is None or len(times) < 2 or not are_increasing(times):
        _check_pose_per_frame(trajectory, len(times))
        poses = trajectory.poses
    else:
        frame_times = np.array(times, np.float64)
        max_time = MAX_TIME_SHARE * float(np.median(np.diff(frame_times)))
        frames, indices = associate(frame_times, trajectory.times, farthest=max_time)
        if not len(frames):
            raise InputError(
                f"no pose is within {max_time:.3g} s of a frame: frames are from "
                f"{frame_times[0]:.3f} to {frame_times[-1]:.3f} s, poses from "
                f"{trajectory.times[0]:.3f} to {trajectory.times[-1]:.3f} s; give poses with the "
                "times of the frames, or one pose for each frame in order, without times (KITTI's "
                "format)"
            )
        poses = np.full((len(frame_times), 4, 4), np.nan)
        poses[frames] = trajectory.poses[indices]
        reason = f"no pose is given within {max_time:.3g} s of it"
    missing = np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2))).tolist()
    return poses, dict.fromkeys(missing, Status("unrelated", reason))


def _check_pose_per_frame(trajectory: Trajectory, count: int) -> None:
    """Raise InputError unless there are as many poses as frames."""
    if trajectory.times is not None and len(trajectory.poses) != count:
        raise InputError(
            f"poses are {len(trajectory.poses)} with times, but the {count} frames have no times "
            "that increase: expected one pose for each frame, or times for all frames"
        )
    check_pose_count(len(trajectory.poses), count)
