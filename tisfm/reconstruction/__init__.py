"""Reconstruction of sequences: one camera path, and the depth of every frame in its scale.

Contents: tracks along the image motion, the camera path from tracks and matched points, depth of
keyframes and of the frames between them, and the folder of a result.
May import: all of `tisfm` except `tisfm.cli` and `tisfm.evaluation`.
"""
