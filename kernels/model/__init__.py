"""The model at one pixel, as code that is generated while a kernel is compiled.

Here: the motion model G, robust data terms, weights of edges, small linear systems, and motion and
depth from the unknowns.
May import: `tisfm.kernels.layout`.
"""

# Replaces a divisor of zero. Its inverse can still be squared in float32 (up to 3e38), and real
# precisions, curvatures and squared gradients are far larger.
MIN_DIVISOR = 1e-12
# Replaces a pivot or weight of zero that is not squared: the unknowns of a pixel without data and
# without neighbours then stay exactly zero.
MIN_PIVOT = 1e-20
# Least ratio of the depths after and before a motion: nothing comes closer to the camera.
MIN_DEPTH_RATIO = 0.05
