"""The stages of the reconstruction of a whole sequence: read, find path and depth, check, write.

Each stage is a function. It takes the frozen results of earlier stages, and returns its own result.
May import: all of `tisfm` except `cli`, `evaluation`, `reconstruction.chunks`,
`reconstruction.entry`, `reconstruction.pipeline` and `reconstruction.streaming`.
"""
