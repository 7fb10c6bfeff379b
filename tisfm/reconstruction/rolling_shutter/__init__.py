"""The readout time of a rolling shutter, and tracks as a global shutter would see them.

May import: `camera`, `shutter`, `reconstruction.calibration`, `reconstruction.frames`,
`reconstruction.geometry`, `reconstruction.mapping` and `reconstruction.tracks`.
"""
