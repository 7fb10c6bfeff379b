"""Frames prepared for all later stages, the image motion between them, and a cache on disk.

May import: `camera`, `errors`, `formats`, `frames`, `lens`, `motion`, `resampling`, `settings`,
`shutter`, `solver`, `sources` and `reconstruction.result`.
"""
