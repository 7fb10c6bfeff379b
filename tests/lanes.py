"""How many lanes kernels are tested with."""

from tisfm import runtime

# One is all that a GPU has: with it, parameters are combined among themselves there.
LANES = [1] if runtime.runs_on_gpu() else [16, 8, 1]
