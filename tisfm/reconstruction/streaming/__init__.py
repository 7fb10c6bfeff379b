"""Endless sequences: frames are read, and yielded with their pose and depth.

May import: `camera`, `errors`, `focal_guess`, `grade`, `runtime`, `settings`, `shutter`, `sources`,
`status`, `trajectory`, `reconstruction`, `reconstruction.calibration`, `reconstruction.depth`,
`reconstruction.frames`, `reconstruction.mapping`, `reconstruction.path`, `reconstruction.result`,
`reconstruction.rolling_shutter` and `reconstruction.tracks`.
"""
