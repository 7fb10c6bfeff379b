"""Memory layout of arrays, and launches of kernels.

Here: lane arrays, conversion between images and lane arrays, reuse of memory, launches.
May import: Taichi and NumPy.
"""

CPU_ARCHS = ("x64", "arm64")
"""Taichi's names of CPUs; the project calls them all "cpu"."""
