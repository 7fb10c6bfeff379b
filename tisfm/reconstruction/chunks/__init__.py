"""A sequence reconstructed in chunks of frames, each by a process of its own, and joined.

Here: which frames a chunk has, the camera that all share, what is kept of a chunk so that nothing
is done twice, and how chunks are brought into one world and one scale by the frames they share.
May import: `camera`, `camera_file`, `errors`, `focal_guess`, `folders`, `formats`, `status`,
`running`, `runtime`, `settings`, `sources`, `threads`, `trajectory`, `version`,
`reconstruction`, `reconstruction.geometry`, `reconstruction.path` and `reconstruction.result`.
"""
