"""The folders that `tisfm run` and `tisfm reconstruct` write, read frame by frame.

Here: `ResultFrames`, the interface through which exports, viewer and reports read both kinds of
folder. `PairFrames` reads the folder of a run, `SequenceFrames` the folder of a reconstruction.
May import: `tisfm.folders`, `tisfm.formats`, `tisfm.reconstruction`, and of the top level `camera`,
`grade`, `interpretation`, `status` and `rigid`.
"""
