"""Kernels of fusion: depth maps compared with one another, a distance field, colours of a surface.

Geometry is handed over as projections: a point on the ray of pixel (x, y) of one view, of inverse
depth d, lies in another at (u, v) and at g times its depth, where (g u, g v, g) is the (3, 4)
matrix times (x, y, 1, d).
May import: `tisfm.kernels.layout` and `tisfm.kernels.model`.
"""
