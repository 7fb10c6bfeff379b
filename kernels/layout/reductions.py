"""Sums over the image whose bits do not depend on the number of threads.

A kernel sums blocks of `BLOCK` strip positions of one row, each by one thread in one order; the
blocks are then added in float64, by one thread.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import LaneGrid, lane_of

BLOCK = 16


def block_sums(grid: LaneGrid, terms: int) -> np.ndarray:
    """Return zeros for the sums of every block, as a kernel takes them: (H, blocks, terms)."""
    shape = (grid.height, -(-grid.strip // BLOCK), terms)
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
