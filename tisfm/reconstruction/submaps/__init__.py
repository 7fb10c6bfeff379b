"""The path of a long sequence: overlapping submaps are mapped one by one, and then joined.

May import: `camera`, `reconstruction.calibration`, `reconstruction.geometry`,
`reconstruction.mapping`, `reconstruction.result` and `reconstruction.tracks`.
"""
