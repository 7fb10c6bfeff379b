"""A sequence reconstructed in chunks of frames, which processes share and which are then joined.

Here: the frames of each chunk, the camera that all chunks share, the record of a complete chunk,
and the placement of chunks in one world and one scale by the frames that they share.
May import: `camera`, `camera_file`, `errors`, `focal_guess`, `folders`, `formats`, `status`,
`running`, `runtime`, `settings`, `sources`, `threads`, `trajectory`, `version`, `reconstruction`,
`reconstruction.geometry`, `reconstruction.path` and `reconstruction.result`.
"""
