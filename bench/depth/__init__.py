"""Errors of depth and of the motion of the camera: ``python -m bench.depth``.

`contest` runs `methods` on `pairs` in turns, `scores` has their errors and `report` the tables.
Imports tisfm and `bench.shared`.
"""
