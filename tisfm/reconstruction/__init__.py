"""Whole sequences: one camera path, and depth of every frame in one scale.

Here: tracks along the image motion, the path that they and matched points show, depth of
keyframes and of the frames between them, and the folder that a result lies in.
May import: all of `tisfm` but `tisfm.cli` and `tisfm.evaluation`.
"""
