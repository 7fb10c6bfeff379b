"""Benchmarks of tisfm: ``python -m bench``, and ``bench.peers``, ``bench.ablation``, ``bench.depth``.

The first stands beside the NumPy reference, the others beside other libraries and settings;
``bench.untextured`` and ``bench.focal`` measure what is hard. All have ``--help``.
"""
