"""How fast each kernel is, and does it agree with the NumPy reference: ``python -m bench``.

`bench_kernels` lists the cases and `bench_stream` measures the memory's bandwidth; `operations`
call kernels, `references` their counterparts, and `multigrid_steps`, `rigid_steps`,
`second_order_steps` and `plane_steps` have both; `traffic` says how many bytes each moves. Imports
tisfm, its kernels and `bench.shared`.
"""
