"""Constants of several kernels and their drivers. This module does not import Taichi."""

# Replaces a divisor of zero. Its inverse can still be squared in float32 (up to 3e38), and real
# precisions, curvatures and squared gradients are far larger.
LEAST_DIVISOR = 1e-12
# Replaces a pivot or weight of zero that is not squared: the unknowns of a pixel without data and
# without neighbours then stay exactly zero.
LEAST_PIVOT = 1e-20
# Least ratio of the depths after and before a motion: nothing comes closer to the camera.
NEAREST = 0.05
