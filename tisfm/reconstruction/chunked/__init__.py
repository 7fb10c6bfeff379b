"""A sequence reconstructed in chunks of frames, each by a process of its own, and joined.

Here: which frames a chunk has, the camera that all share, what is kept of a chunk so that nothing
is done twice, and how chunks are brought into one world and one scale by the frames they share.
May import: all of `tisfm` but `tisfm.cli` and `tisfm.evaluation`.
"""
