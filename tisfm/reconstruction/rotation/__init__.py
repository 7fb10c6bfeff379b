"""Orientations of a camera that only turns, and its focal length, from tracks and matches.

May import: `camera`, `reconstruction.calibration`, `reconstruction.mapping` and
`reconstruction.tracks`.
"""
