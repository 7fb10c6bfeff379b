"""The focal length and the radial distortion of a camera, estimated together with its path.

May import: `camera`, `camera_file`, `focal_guess`, `sources`, `reconstruction.mapping`,
`reconstruction.result` and `reconstruction.tracks`.
"""
