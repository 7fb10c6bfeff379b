"""Kernels of fusion: comparison of depth maps, a signed distance field, colours of a surface.

Geometry is given by projections. A projection from one view to another is a (3, 4) matrix P with
(g u, g v, g) = P (x, y, 1, d): a point of inverse depth d at pixel (x, y) of the first view is at
(u, v) in the other view, and its depth there is g times its depth in the first view.
May import: `tisfm.kernels.layout` and `tisfm.kernels.model`.
"""
