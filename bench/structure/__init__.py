"""What the source is made of, and the way of a frame through it: ``python -m bench.structure``.

`source` reads packages, imports, cycles and lines of code of a checkout from its source alone,
`drawing` draws them; `tracer` follows one interpretation in a process of its own, and `way` says
how it went. Imports nothing of tisfm, so that any checkout will do, and of bench
only `bench.shared`.
"""
