"""Memory layout of arrays, and launches of kernels.

Here: lane arrays, conversion between images and lane arrays, reuse of memory, launches.
May import: Taichi and NumPy.
"""

CPU_ARCHS = ("x64", "arm64")
"""Archs that are CPUs; the project calls them all "cpu"."""
