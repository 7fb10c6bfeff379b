"""Folders that tisfm writes results to.

Here: the lock of a folder, the removal of files that killed processes left, check sums, the record
of a run, and the page and the timings beside a result.
May import: `tisfm.formats`, `tisfm.trajectory` (times), and of the top level `errors` and
`status`.
"""
