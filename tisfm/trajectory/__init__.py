"""Trajectories: the poses of the frames of a sequence, and the text files of TUM and KITTI.

Poses are (N, 4, 4) float64, camera to world; NaN stands for a frame without a pose.

May import: `tisfm.formats`, and of the top level `checks` and `rigid`.
"""

from tisfm.trajectory.poses import Trajectory
from tisfm.trajectory.text_files import (
    read_kitti,
    read_trajectory,
    read_tum,
    write_kitti,
    write_tum,
)
from tisfm.trajectory.times import associate

__all__ = [
    "Trajectory",
    "associate",
    "read_kitti",
    "read_trajectory",
    "read_tum",
    "write_kitti",
    "write_tum",
]
