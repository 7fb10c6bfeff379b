"""Paths of a camera: the poses of the frames of a sequence, in the files that others read.

Poses are (N, 4, 4) float64, camera to world; a frame without a pose has NaN.
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
