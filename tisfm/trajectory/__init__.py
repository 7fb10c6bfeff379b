"""Paths of a camera: the poses of the frames of a sequence, in the files that others read.

Poses are (N, 4, 4) float64, camera to world; a frame without a pose has NaN.
May import: `tisfm.formats`, and of the top level `checks` and `rigid`.
"""

from tisfm.trajectory.association import associate
from tisfm.trajectory.kitti import read_kitti, write_kitti
from tisfm.trajectory.path import Trajectory
from tisfm.trajectory.reading import read_trajectory
from tisfm.trajectory.tum import read_tum, write_tum

__all__ = [
    "Trajectory",
    "associate",
    "read_kitti",
    "read_trajectory",
    "read_tum",
    "write_kitti",
    "write_tum",
]
