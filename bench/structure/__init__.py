"""Packages and imports of the source, and the call path of a pair: ``python -m bench.structure``.

`source` reads packages, imports, cycles and lines of code of a checkout, without running it, and
`drawing` draws them. `tracer` follows one interpretation in its own process, and `way` has the
calls between modules. Imports nothing of tisfm, so that any checkout can be read, and of bench
only `bench.shared`.
"""
