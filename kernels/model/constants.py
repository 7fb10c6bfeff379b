"""Numbers that several kernels and their drivers share. None of them needs Taichi."""

# In place of a divisor that is zero: its inverse can still be squared in float32 (up to 3e38), and
# real precisions, curvatures and squared gradients are far larger.
LEAST_DIVISOR = 1e-12
# In place of a pivot or a weight that is zero and is not squared: it keeps a pixel without data and
# without neighbours exactly at zero.
LEAST_PIVOT = 1e-20
# Least depth after a motion over the depth before: nothing comes closer to the camera.
NEAREST = 0.05
