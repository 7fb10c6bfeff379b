"""Depth of every frame with a known pose, and joint adjustment of poses and depth.

May import: `camera`, `errors`, `kernels`, `motion`, `rigid`, `runtime`, `settings`, `solver`,
`reconstruction.geometry`, `reconstruction.mapping` and `reconstruction.tracks`.
"""
