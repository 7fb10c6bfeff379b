"""Kernels of rigid motions: epipolar lines, normal equations, plane sweep, PatchMatch.

May import: `tisfm.kernels.layout`, `tisfm.kernels.model` and `tisfm.kernels.solve`.
"""
