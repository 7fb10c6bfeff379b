"""Depth of every frame whose pose is known, and poses adjusted together with depth.

May import: `camera`, `errors`, `kernels`, `motion`, `rigid`, `runtime`, `settings`, `solver`,
`reconstruction.geometry`, `reconstruction.mapping` and `reconstruction.tracks`.
"""
