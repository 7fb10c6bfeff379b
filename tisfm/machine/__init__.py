"""Properties of the machine that the libraries we use do not handle by themselves.

Here: limits of the address space, freed memory, Taichi's cache of compiled kernels, the device that
Vulkan offers, and text for terminals.
May import: nothing of `tisfm`.
"""
