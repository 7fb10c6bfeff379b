"""What a whole pair costs: ``python -m bench``.

`bench_pair` times `tisfm.interpret` and the NumPy reference on the same pair and compares their
answers; `memory` measures the peak of one interpretation in a process of its own. Imports tisfm
and `bench.shared`.
"""
