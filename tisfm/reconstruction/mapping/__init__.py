"""Camera poses and sparse points of views, found and adjusted by pycolmap.

May import: `camera`, `rigid`, `reconstruction.geometry`, `reconstruction.result` and
`reconstruction.tracks`.
"""
