"""The folders that `tisfm run` and `tisfm reconstruct` write, read frame by frame.

Here: one view of both kinds of folder for exports, the viewer, reports and evaluation.
May import: `tisfm.folders`, `tisfm.formats`, `tisfm.reconstruction`, and of the top level `camera`,
`interpretation`, `status` and `rigid`.
"""
