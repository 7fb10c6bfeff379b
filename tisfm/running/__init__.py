"""Work on sequences: pairs shared by processes, and the folder that a run writes.

Here: the pool of processes (of this machine or of a Dask cluster), the thread that writes beside
the computation, the pairs of a source in chunks, and the files and the record of a run.
May import: all of `tisfm` but `tisfm.cli` and `tisfm.evaluation`.
"""
