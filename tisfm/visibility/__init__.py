"""Which pixels are seen in both frames, and how far their motion is to be trusted.

Here: occlusion by the uniqueness of the mapping, and confidence by the precision of the data.
May import: `tisfm.solver` (sampling of images), `tisfm.kernels`, and of the top level `runtime`
and `settings`.
"""
