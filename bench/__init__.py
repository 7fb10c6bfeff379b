"""Benchmarks of tisfm against its NumPy reference; ``python -m bench --help``."""
