"""From images to constraints on the flow.

Here: warping, derivatives, constraints, image-driven edges, and forward splatting for occlusion.
May import: `tisfm.kernels.layout` and `tisfm.kernels.model`.
"""
