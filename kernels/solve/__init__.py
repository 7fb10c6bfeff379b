"""The linear system with fixed weights, and the update of the weights.

Here: relaxation, transfers between grids, line search, weight update, data precision, sums.
May import: `tisfm.kernels.layout` and `tisfm.kernels.model`.
"""
