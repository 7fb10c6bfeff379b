"""Tracks along the image motion, views, matches between views, and triangulated tracks.

May import: `camera`, `errors`, `motion`, `settings`, `reconstruction.frames` and
`reconstruction.geometry`.
"""
