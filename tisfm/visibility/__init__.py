"""Occlusion and confidence of pixels.

Occlusion follows from the uniqueness of the mapping, confidence from the precision of the data.
May import: `tisfm.solver` (sampling of images), `tisfm.kernels`, and of the top level `runtime`
and `settings`.
"""
