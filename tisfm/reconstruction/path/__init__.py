"""The camera path of a sequence, estimated from its frames or given.

May import: `camera`, `checks`, `errors`, `shutter`, `status`, `trajectory`,
`reconstruction.calibration`, `reconstruction.causes`, `reconstruction.frames`,
`reconstruction.geometry`, `reconstruction.joints`, `reconstruction.mapping`,
`reconstruction.result`, `reconstruction.rolling_shutter`, `reconstruction.rotation`,
`reconstruction.submaps` and `reconstruction.tracks`.
"""
