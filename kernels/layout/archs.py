"""Taichi's names of where kernels run. They need no Taichi."""

HOSTS = ("x64", "arm64")
"""CPUs, which are all called "cpu" here."""
