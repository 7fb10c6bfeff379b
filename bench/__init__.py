"""Benchmarks of tisfm: ``python -m bench`` and the commands below, all with ``--help``.

Packages by question: `kernels` and `pairs` time against the NumPy reference (``bench``), `flow`
and `depth` stand beside other libraries (``bench.peers``, ``bench.depth``) and beside changes
(``bench.ablation``, ``bench.solvers``, ``bench.untextured``, ``bench.focal``), `objects` measures
things that move (``bench.objects``), `sequences` whole sequences (``bench.sequences``,
``bench.writing``), `scaling` time and memory over size (``bench.scaling``),
`regression` another checkout (``bench.regression``), `structure` the source itself
(``bench.structure``). What they share is in `shared`, which imports none of them. `reference` is
the method in plain NumPy, which the tests import as well.
"""
