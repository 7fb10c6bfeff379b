"""The folders that `tisfm run` and `tisfm reconstruct` write, read frame by frame.

Here: `ResultFrames`, what exports, viewer and reports read of both kinds of folder. `PairFrames`
are those of a run, `SequenceFrames` those of a reconstruction.
May import: `tisfm.folders`, `tisfm.formats`, `tisfm.reconstruction`, and of the top level `camera`,
`interpretation`, `status` and `rigid`.
"""
