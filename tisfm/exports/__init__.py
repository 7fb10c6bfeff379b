"""Results in the files that other programs read.

Here: the path of the camera, points and surfaces, the moving camera and its lens, undistortion
maps, depth, masks and videos; models of COLMAP and nerfstudio, with tracks of points that are
measured in the frames; and the list of all formats.
May import: all of `tisfm` but `tisfm.cli` and `tisfm.evaluation`.
"""

from tisfm.exports.camera_path import write_chan, write_gltf_cameras
from tisfm.exports.colmap import ExportedModel, write_colmap
from tisfm.exports.frame_maps import write_depths, write_masks
from tisfm.exports.nerfstudio import write_nerfstudio
from tisfm.exports.surfaces import write_meshes, write_points
from tisfm.exports.trajectories import write_kitti_paths, write_tum_paths
from tisfm.exports.undistortion import write_undistortion
from tisfm.exports.videos import write_video
from tisfm.results.pair_frames import PairFrames
from tisfm.results.sequence_frames import SequenceFrames

__all__ = [
    "ExportedModel",
    "PairFrames",
    "SequenceFrames",
    "write_chan",
    "write_colmap",
    "write_depths",
    "write_gltf_cameras",
    "write_kitti_paths",
    "write_masks",
    "write_meshes",
    "write_nerfstudio",
    "write_points",
    "write_tum_paths",
    "write_undistortion",
    "write_video",
]
