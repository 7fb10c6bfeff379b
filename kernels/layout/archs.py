"""Taichi's names of CPU archs. This module does not import Taichi."""

HOSTS = ("x64", "arm64")
"""Archs that are CPUs; the project calls them all "cpu"."""
