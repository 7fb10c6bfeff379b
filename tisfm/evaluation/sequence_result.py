"""Results that are compared with a sequence: a reconstruction, or a trajectory from a file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tisfm.datasets import LoadedSequence
from tisfm.errors import InputError
from tisfm.trajectory import Trajectory, associate


class SequenceResult(Protocol):
    """A result to compare: `tisfm.Reconstruction`, or an object with the same attributes."""

    @property
    def poses(self) -> NDArray[np.float64]:
        """(N, 4, 4), camera to world; NaN for a frame without a pose."""

    @property
    def piece(self) -> NDArray[np.int32]:
        """(N,), piece of each frame, with its own world; −1 without a pose."""

    @property
    def status(self) -> Sequence[Any]:
        """Status of each frame."""

    def inverse_depth(self, index: int) -> NDArray[np.float32]:
        """Return the inverse depth of a frame, (H, W); NaN if unknown."""

    def inverse_depth_std(self, index: int) -> NDArray[np.float32]:
        """Return the standard deviation of inverse depth, (H, W)."""


class TrajectoryResult:
    """A trajectory from a file, as a result without depth.

    Raises ValueError if the number of poses differs from the frames, or no time belongs to a frame.
    """

    def __init__(
        self,
        # with times, it has poses of some frames; without times, a pose for every frame
        trajectory: Trajectory,
        loaded: LoadedSequence,  # The frames. Without times, their numbers 0, 1, 2, … are used.
        source: Path,  # file of the trajectory, for messages
    ) -> None:
        count = len(loaded.frames)
        self.poses = trajectory.poses
        if trajectory.times is not None:
            times = np.arange(count, dtype=float) if loaded.times is None else loaded.times
            frame_indices, pose_indices = associate(times, trajectory.times)
            if not len(frame_indices):
                unit = "numbers of frames" if loaded.times is None else "s"
                raise InputError(
                    f"{source} has no pose of any frame: its times begin at "
                    f"{trajectory.times[0]:g}, the times of the frames at {times[0]:g} ({unit})"
                )
            self.poses = np.full((count, 4, 4), np.nan)
            self.poses[frame_indices] = trajectory.poses[pose_indices]
        elif len(trajectory.poses) != count:
            raise InputError(
                f"{source} has {len(trajectory.poses)} poses, but there are {count} frames: "
                "expected a line for every frame, or times (TUM's format)"
            )
        has_pose = np.isfinite(self.poses[:, 0, 0])
        self.piece = np.where(has_pose, 0, -1).astype(np.int32)
        self.status = ["read" if is_posed else "no pose" for is_posed in has_pose]

    def inverse_depth(self, index: int) -> NDArray[np.float32]:
        """Raise ValueError: a trajectory has no depth."""
        raise InputError(f"frame {index} has no depth: a trajectory was read")

    inverse_depth_std = inverse_depth
