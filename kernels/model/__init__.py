"""The model at one pixel, written out while a kernel is compiled.

Here: the motion model G, robust data terms, weights of edges, small linear systems, and what is
read off the unknowns.
May import: `tisfm.kernels.layout`.
"""
