"""Moving objects: the labels of every frame, and the path and depth of each object.

May import: `camera`, `grade`, `motion`, `settings`, `reconstruction.depth`,
`reconstruction.frames`, `reconstruction.geometry`, `reconstruction.mapping`, `reconstruction.path`,
`reconstruction.result` and `reconstruction.tracks`.
"""
