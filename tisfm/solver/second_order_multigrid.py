"""Multigrid for inverse depth D and its slopes v₁ and v₂ (`tisfm.kernels.solve.second_order`).

With second-order smoothness, only coarse grids carry a correction across a wide region without
data. A sweep is less effective there than on fine grids: D and its slopes must change together over
many pixels, but a sweep solves for the three unknowns of one pixel at a time. So from the second
coarse grid on, each grid has twice as many sweeps as the next finer grid. All sweeps together cost
as much as three sweeps of the finest grid.

A lane array holds an image as vertical strips of even width (`tisfm.kernels.layout.lanes`). In a
halved array, each strip holds half of a strip of the finer grid (`tisfm.kernels.solve.coarsening`).
"""

from collections.abc import Callable
from dataclasses import replace

from tisfm.kernels.layout.lanes import LaneData, LaneGrid, aligned_zeros
from tisfm.kernels.layout.launch import join_launches
from tisfm.kernels.solve.coarsening import (
    coarse_grid,
    halved_shape,
    interpolation_columns,
    relayout,
)
from tisfm.kernels.solve.second_order.coarsening import add_correction, offset_columns
from tisfm.kernels.solve.second_order.stencil import COMPONENTS, WEIGHTS
from tisfm.kernels.solve.second_order.system import SecondOrderSystem

COARSEST_GRID_SIDE = 4  # px: largest longer side of the coarsest grid
COARSEST_SWEEPS = 32  # on the coarsest grid, in place of a correction
MAX_SWEEPS = 32  # on a grid, before and again after a correction
RELAXATION = 1.2  # over-relaxation of the sweeps


class SecondOrderMultigrid:
    """V-cycles over D and its slopes."""

    def __init__(
        self,
        # the system to solve; its tensor and weights are used without a copy
        system: SecondOrderSystem,
        # lane array, 3 components: D, v₁, v₂; `cycle` and `descend` modify it in place
        rho: LaneData,
        *,
        relaxation: float = RELAXATION,  # over-relaxation of the sweeps, in (0, 2)
    ) -> None:
        grid = system.grid
        self._system, self._rho = system, rho
        levels = [_Level(system, rho, None, relaxation=relaxation, sweeps=1)]
        transfers = []
        while max(levels[-1].size) > COARSEST_GRID_SIDE:
            sweeps = max(1, min(2 ** (len(levels) - 1), MAX_SWEEPS))
            levels.append(levels[-1].coarser(sweeps))
            transfers.append(_Transfer(levels[-2], levels[-1]))
        self._levels, self._transfers = levels, transfers
        self._solve_coarsest = levels[-1].bind_smooth(COARSEST_SWEEPS)
        self._previous, self._step = grid.allocate(COMPONENTS), grid.allocate(COMPONENTS)
        self._search = system.bind_line_search(rho, self._previous, self._step)
        self.restart()

    def coarsen(self) -> None:
        """Compute the coarse systems; necessary whenever tensor or weights have changed."""
        for transfer in self._transfers:
            transfer.coarsen()

    def restart(self) -> None:
        """Drop the last step and start at the present ρ; necessary if other code changed ρ."""
        self._system.grid.copy(self._rho, self._previous)
        self._step.fill(0)

    def descend(self) -> None:
        """Run one V-cycle, then minimise the energy over its correction and the last step.

        The minimum is taken in the plane of these two directions. The energy never rises.
        """
        self.cycle()
        self._search()

    def cycle(self) -> None:
        """Run one V-cycle."""
        for fine, transfer in zip(self._levels, self._transfers, strict=False):
            fine.smooth()
            transfer.restrict()
        self._solve_coarsest()
        for fine, transfer in zip(self._levels[-2::-1], self._transfers[::-1], strict=True):
            transfer.correct()
            fine.smooth()


class Interpolation:
    """Interpolation of D and its slopes from a grid of half the density."""

    def __init__(
        self,
        grid: LaneGrid,  # the fine grid
        # coarse, rho: lane arrays, 3 components, of `coarse_grid(grid)` and of `grid`. A call adds
        # the interpolated `coarse` to `rho`.
        coarse: LaneData,
        rho: LaneData,
        spacing: float,  # h of the fine grid
    ) -> None:
        # Strips of the coarse grid have an even width; half of a fine strip may be odd.
        halved_array = coarse if has_halved_layout(grid) else allocate_halved(grid, COMPONENTS)
        _, outer_offsets = offset_columns(grid)
        tables = (*interpolation_columns(grid), outer_offsets)
        parent_weight, neighbour_weight, outer_offset = (grid.place(table) for table in tables)
        add = add_correction.bind(
            grid,
            halved_array,
            (parent_weight, neighbour_weight, outer_offset),
            rho,
            spacing=spacing,
        )
        needs_relayout = halved_array is not coarse
        self._run = (
            join_launches(relayout.bind(coarse_grid(grid), coarse, halved_array), add)
            if needs_relayout
            else add
        )

    def __call__(self) -> None:
        """Add the interpolated coarse values."""
        self._run()


class _Level:
    """A grid, its system and its unknown: ρ on the finest grid, a correction on coarser grids."""

    def __init__(
        self,
        system: SecondOrderSystem,
        rho: LaneData,
        source: LaneData | None,  # right-hand side of a correction; None on the finest grid
        *,
        relaxation: float,
        sweeps: int,
    ) -> None:
        self.system, self.rho = system, rho
        self.source: LaneData = source
        self._relaxation = relaxation
        self.size = system.grid.height, system.grid.width
        self.smooth = self.bind_smooth(sweeps)

    def bind_smooth(self, sweeps: int) -> Callable[[], None]:
        """Return a function that runs `sweeps` sweeps."""
        return self.system.bind_sweep(
            self.rho, relaxation=self._relaxation, sweeps=sweeps, source=self.source
        )

    def coarser(self, sweeps: int) -> "_Level":
        """Return the level of half the density; a `_Transfer` computes its system."""
        fine = self.system
        grid = coarse_grid(fine.grid)
        system = replace(
            fine,
            grid=grid,
            tensor=grid.allocate(COMPONENTS),
            weights=grid.allocate(WEIGHTS),
            spacing=2 * fine.spacing,
            spread=fine.spread + fine.spacing**2 / 4,
        )
        return _Level(
            system,
            grid.allocate(COMPONENTS),
            grid.allocate(COMPONENTS),
            relaxation=self._relaxation,
            sweeps=sweeps,
        )


class _Transfer:
    """The transfers between a level and the next coarser level."""

    def __init__(self, fine: _Level, coarse: _Level) -> None:
        self._coarse, grid = coarse, fine.system.grid
        targets = (coarse.system.tensor, coarse.system.weights, coarse.source)
        relayouts: list[Callable[[], None]] = []
        arrays = targets
        if not has_halved_layout(grid):
            arrays = tuple(allocate_halved(grid, array.shape[0]) for array in targets)
            relayouts = [
                relayout.bind(coarse.system.grid, *pair)
                for pair in zip(arrays, targets, strict=True)
            ]
        tensor, weights, source = arrays
        self.coarsen = join_launches(fine.system.bind_coarsen(tensor, weights), *relayouts[:2])
        offsets, _ = offset_columns(grid)
        self._restrict = join_launches(
            fine.system.bind_restrict(grid.place(offsets), fine.rho, source, source=fine.source),
            *relayouts[2:],
        )
        self.correct = Interpolation(grid, coarse.rho, fine.rho, fine.system.spacing)

    def restrict(self) -> None:
        """Restrict the residual to the coarser level, and set its correction to zero."""
        self._restrict()
        self._coarse.rho.fill(0)


def has_halved_layout(grid: LaneGrid) -> bool:
    """Return whether halved arrays of a grid are lane arrays of the coarser grid."""
    return grid.strip_width // 2 == coarse_grid(grid).strip_width


def allocate_halved(grid: LaneGrid, components: int) -> LaneData:
    """Return an array of zeros with the halved layout of a grid."""
    return grid.place(aligned_zeros(halved_shape(grid, components)))
