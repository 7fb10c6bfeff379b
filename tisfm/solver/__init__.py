"""The linear system and its solution from coarse to fine.

Here: image pyramids, unknowns of a level, data term, smoothness, half-quadratic iterations,
multigrid, and sampling of images. Nothing here depends on the motion model.
May import: `tisfm.kernels`, and of the top level `camera`, `runtime` and
`threads`.
"""
