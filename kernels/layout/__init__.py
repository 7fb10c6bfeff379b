"""Memory layout of arrays, and launches of kernels.

Here: lane arrays, conversion between images and lane arrays, reuse of memory, launches.
May import: Taichi and NumPy.
"""
