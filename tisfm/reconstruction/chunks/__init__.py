"""Reconstruction of a sequence in chunks of frames: processes compute chunks, which are joined.

Here: the frames of each chunk, the common camera of all chunks, the record of a complete chunk, the
placement of chunks in one world and one scale, by the frames that neighbour chunks share, and the
ids of moving objects.
May import: `camera`, `camera_file`, `errors`, `focal_guess`, `folders`, `formats`, `status`,
`running`, `runtime`, `settings`, `sources`, `threads`, `trajectory`, `version`, `reconstruction`,
`reconstruction.geometry`, `reconstruction.objects`, `reconstruction.path` and
`reconstruction.result`.
"""
