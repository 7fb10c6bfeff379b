"""Sums over the image that are bitwise the same for any number of threads.

A kernel sums blocks of `BLOCK` strip positions of a row. One thread sums each block in a fixed
order; then one thread adds all blocks in float64.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import LaneGrid, lane_of

BLOCK = 16  # strip positions


def block_sums(grid: LaneGrid, terms: int) -> np.ndarray:
    """Return zeros, (H, blocks, terms), into which a kernel writes the sums of all blocks."""
    shape = (grid.height, -(-grid.strip_width // BLOCK), terms)
    return np.zeros(shape, np.float32 if grid.lanes == 1 else np.float64)


def add_blocks(partial: np.ndarray) -> np.ndarray:
    """Return the sums over the image, (terms,) float64."""
    return np.einsum("ybt->t", partial, dtype=np.float64)


@ti.func
def store_sum(partial: ti.template(), row, block, term: ti.template(), value, lanes: ti.template()):
    """Write the sum of a value's lanes to an element of `partial`."""
    if ti.static(lanes == 1):
        partial[row, block, term] = value
    else:
        total = ti.cast(0.0, ti.f64)
        for lane in range(lanes):
            total += ti.cast(lane_of(value, lane, lanes), ti.f64)
        partial[row, block, term] = total
