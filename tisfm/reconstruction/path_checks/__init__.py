"""Checks of a path by evidence that the path was not made from; pixels fixed on the sensor.

May import: `camera`, `kernels`, `motion`, `reconstruction.frames`, `reconstruction.mapping`,
`reconstruction.result` and `reconstruction.tracks`.
"""
