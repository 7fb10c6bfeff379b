"""How good the flow is, and at what cost.

`peers` sets it beside other libraries, `ablation` beside changes of a preset; `solvers` measures
how fast the linear system converges, `untextured` what happens where there is no texture. Each has
a command, ``python -m bench.NAME``. Imports tisfm and `bench.shared`.
"""
