"""The linear system and how it is solved, from coarse to fine.

Here: image pyramids, unknowns of a level, data term, smoothness, half-quadratic iterations,
multigrid, and sampling of images. Nothing here knows which motion model asks for it.
May import: `tisfm.kernels`, and of the top level `camera`, `runtime` and
`threads`.
"""
