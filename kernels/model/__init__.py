"""The model at one pixel, as code that is generated while a kernel is compiled.

Here: the motion model G, robust data terms, weights of edges, small linear systems, and motion and
depth from the unknowns.
May import: `tisfm.kernels.layout`.
"""
