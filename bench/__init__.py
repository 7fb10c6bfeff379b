"""Benchmarks of tisfm: ``python -m bench`` and the commands below, all with ``--help``.

The first stands beside the NumPy reference; ``bench.peers`` and ``bench.depth`` beside other
libraries, ``bench.ablation`` beside other settings; ``bench.untextured`` and ``bench.focal``
measure what is hard.
"""
