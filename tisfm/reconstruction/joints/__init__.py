"""Joints between pieces of a path that share no tracks, by direct alignment.

May import: `camera`, `reconstruction.geometry`, `reconstruction.mapping`, and
`reconstruction.tracks`.
"""
