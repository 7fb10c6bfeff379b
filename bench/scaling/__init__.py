"""How time and memory of a pair grow with its size: ``python -m bench.scaling``.

`worker` times pairs and their stages in its own process.
Imports tisfm and `bench.shared`; the memory comes from a process of `bench.pair_memory`.
"""
