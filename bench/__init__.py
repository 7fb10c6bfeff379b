"""Benchmarks of tisfm: ``python -m bench`` and the commands below, all with ``--help``.

Commands on pairs of frames are modules of this package: `peers` compares flow with other libraries,
`ablation` changes settings, `window` uses three frames; `solvers` measures the convergence of the
linear system, `untextured` and `focal` difficult input, `writing` the cost of storing results,
`sensitivity` the effect of settings, and `pair_memory` is a process that measures memory.

Packages: `kernels` times kernels and whole pairs against the NumPy `reference` (``bench``), `depth`
measures depth and motion of the camera, `objects` moving objects, `sequences` whole sequences,
`scaling` time and memory over size, `view` the viewer, `trust` whether results that are reported
as good are wrong, and `regression` another checkout. `shared` is their common code; it imports no
benchmark.
"""
