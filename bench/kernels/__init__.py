"""Times of each kernel and of whole pairs, and agreement with the reference: ``python -m bench``.

`bench_kernels` lists the cases, `bench_pair` times whole pairs, and `bench_stream` measures the
bandwidth of the memory. `operations` call kernels and `references` their counterparts in NumPy;
`multigrid_steps`, `rigid_steps`, `second_order_steps` and `plane_steps` have both. `traffic` has
the bytes that each kernel moves. Imports tisfm, its kernels, `bench.reference` and `bench.shared`.
"""
