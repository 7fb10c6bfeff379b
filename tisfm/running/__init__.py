"""Runs: one or several processes interpret the pairs of a sequence, and write the results.

Here: the pool of processes (of this machine or of a Dask cluster), the thread that writes results
during the computation, chunks of pairs, and the files and the record of a run.
May import: all of `tisfm` but `tisfm.cli` and `tisfm.evaluation`.
"""
