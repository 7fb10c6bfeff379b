"""Kernels of rigid motions: epipolar lines, normal equations of a motion, and the plane sweep.

May import: `tisfm.kernels.layout`, `tisfm.kernels.model` and `tisfm.kernels.solve`.
"""
