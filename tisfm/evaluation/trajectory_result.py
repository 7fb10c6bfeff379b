"""A path that was read, in the place of a reconstruction."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.datasets import LoadedSequence
from tisfm.errors import InputError
from tisfm.trajectory import Trajectory, associate


class TrajectoryResult:
    """A trajectory that was read, as the result of a reconstruction without depth.

    Parameters
    ----------
    trajectory : Trajectory
        One with times has the frames that have a pose; one without has a pose for every frame.
    loaded : LoadedSequence
        The frames. Where they have no times, their numbers 0, 1, 2, … stand for them.
    source : Path
        Where the trajectory was read, for errors.

    Raises
    ------
    ValueError
        If it is of another number of frames, or no times are those of frames.
    """

    def __init__(self, trajectory: Trajectory, loaded: LoadedSequence, source: Path) -> None:
        count = len(loaded.frames)
        self.poses = trajectory.poses
        if trajectory.times is not None:
            times = np.arange(count, dtype=float) if loaded.times is None else loaded.times
            mine, theirs = associate(times, trajectory.times)
            if not len(mine):
                unit = "numbers of frames" if loaded.times is None else "s"
                raise InputError(
                    f"{source} has no pose of any frame: its times begin at "
                    f"{trajectory.times[0]:g}, those of the frames at {times[0]:g} ({unit})"
                )
            self.poses = np.full((count, 4, 4), np.nan)
            self.poses[mine] = trajectory.poses[theirs]
        elif len(trajectory.poses) != count:
            raise InputError(
                f"{source} has {len(trajectory.poses)} poses, but there are {count} frames: "
                "expected a line for every frame, or times (TUM's format)"
            )
        posed = np.isfinite(self.poses[:, 0, 0])
        self.piece = np.where(posed, 0, -1).astype(np.int32)
        self.status = ["read" if known else "no pose" for known in posed]

    def inverse_depth(self, index: int) -> NDArray[np.float32]:
        """Refuse: there is none."""
        raise InputError(f"frame {index} has no depth: a trajectory was read")

    inverse_depth_std = inverse_depth
