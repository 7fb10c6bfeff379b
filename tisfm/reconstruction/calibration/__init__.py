"""The focal length and the radial distortion of a camera, found together with its path.

May import: `camera`, `focal_guess`, `reconstruction.mapping`, `reconstruction.result` and
`reconstruction.tracks`.
"""
