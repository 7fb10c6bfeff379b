"""The result of a reconstruction and its folder: record, depth, labels, moving objects, request.

May import: `camera`, `camera_file`, `errors`, `focal_guess`, `folders`, `formats`, `fusion`,
`grade`, `motion`, `point_cloud`, `runtime`, `settings`, `sources`, `status`, `trajectory` and
`version`.
"""
