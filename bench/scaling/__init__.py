"""How time and memory of a pair grow with its size: ``python -m bench.scaling``.

`worker` times pairs and their stages in its own process. A process of `bench.pair_memory` measures
the memory. Imports tisfm and `bench.shared`.
"""
