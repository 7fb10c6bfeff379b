"""Folders of results.

Here: the lock of a folder, the removal of the temporary files of killed processes, check sums, the
record of a run, and the report and the timings of a result.
May import: `tisfm.formats`, `tisfm.trajectory` (times), and of the top level `errors`,
`grade` and `status`.
"""
