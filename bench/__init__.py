"""Benchmarks of tisfm: ``python -m bench``, ``bench.peers`` and ``bench.ablation``, ``--help``.

The first stands beside the NumPy reference, the others beside other libraries and settings.
"""
