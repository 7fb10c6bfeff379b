"""A sweep with one pass over memory for each color; the library needs one pass for both colors.

It shows whether relaxation keeps up with memory without caches. The difference to
`tisfm.kernels.solve.relaxation` is the gain of fusing both colors.
"""

import taichi as ti

from tisfm.kernels.layout.internals import bind
from tisfm.kernels.layout.lanes import (
    CHUNK,
    INDEX_MASK,
    LaneArray,
    LaneData,
    component_starts,
    first_row,
    lane_kernel,
    refresh_halo,
)
from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.kernels.solve.relaxation import RELAXATION_BAND, relax_at


def sweep_unfused(system: LinearSystem, rho: LaneData, *, relaxation: float, solver: str) -> None:
    """Sweep red everywhere and then black, as `LinearSystem.sweep` does.

    This needs several lanes; with one lane, the sweep of the library is already unfused.
    """
    grid = system.grid
    if grid.lanes == 1:
        raise ValueError("the grid has 1 lane: expected 8 or 16")
    _sweep_unfused[grid.lanes](
        *system.arrays,
        relaxation,
        system.components,
        system.weights_per_edge,
        solver == "closed_form",
        max(1, grid.height // RELAXATION_BAND),
        rho,
    )


@lane_kernel
def _sweep_unfused(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    alpha: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    relaxation: ti.f32,
    n: ti.template(),
    weight_count: ti.template(),
    closed_form: ti.template(),
    bands: ti.i32,
    rho: LaneArray(3),  # (n, H+2, S+2), in place
):
    height = rho.shape[1] - 2
    pairs = (rho.shape[2] - 2) // 2
    for color in ti.static(range(2)):
        for task in range(CHUNK * bands):
            if task % CHUNK == 0:
                alphas = ti.static([bind(alpha[k]) for k in range(n)])
                stride = rho.shape[2] & INDEX_MASK
                starts = ti.static(component_starts(rho, max(6, 2 * weight_count)))
                band = task // CHUNK
                for row in range(
                    first_row(band, height, bands), first_row(band + 1, height, bands)
                ):
                    for pair in range(pairs):
                        s = 2 * pair + (row + color) % 2 + 1
                        relax_at(
                            tensor, weights, x_hat, y_hat, rho, alphas, stride, starts,
                            relaxation, n, weight_count, closed_form, False, rho, row + 1, s,
                        )  # fmt: skip
                    for k in range(n):
                        refresh_halo(rho, k, row + 1)
