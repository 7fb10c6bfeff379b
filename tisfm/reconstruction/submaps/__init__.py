"""The path of a long sequence: overlapping submaps, each mapped by itself and then joined.

May import: `camera`, `reconstruction.calibration`, `reconstruction.geometry`,
`reconstruction.mapping`, `reconstruction.result` and `reconstruction.tracks`.
"""
