"""Kernels of rigid motions: epipolar lines, normal equations of a motion, the plane sweep,
and PatchMatch over planes.

May import: `tisfm.kernels.layout`, `tisfm.kernels.model` and `tisfm.kernels.solve`.
"""
