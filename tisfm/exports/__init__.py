"""Reconstructions in the files that other programs read.

Here: tracks of points, measured in the frames, and models of COLMAP and nerfstudio with them.
May import: all of `tisfm` but `tisfm.cli` and `tisfm.evaluation`.
"""

from tisfm.exports.colmap import ExportedModel, write_colmap
from tisfm.exports.nerfstudio import write_nerfstudio

__all__ = ["ExportedModel", "write_colmap", "write_nerfstudio"]
