"""Multigrid for the linear system of fixed weights (eq. 16, 22–23).

Sweeps reduce smooth errors slowly. On a grid of half the density the same error is less smooth, and
a sweep costs a quarter. A V-cycle sweeps once, solves for the correction on the coarser grid in the
same way, adds the correction and sweeps once more.

The coarse system has averaged motion tensors and averaged edge weights. Its image coordinates x̂ and
ŷ belong to the coarse pixels.

ρ̂ are the unknowns of a pixel. Equations are numbered as in the paper (docs/method.md). A lane array
holds an image as vertical strips (`tisfm.kernels.layout.lanes`). In a halved array, each strip
holds half of a strip of the finer grid (`tisfm.kernels.solve.coarsening`).
"""

from collections.abc import Callable
from dataclasses import replace

from tisfm.kernels.layout.lanes import LaneData, LaneGrid, aligned_zeros
from tisfm.kernels.solve.coarsening import (
    add_correction,
    coarse_grid,
    halved_shape,
    interpolation_columns,
    relayout,
)
from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.solver.unknowns import Unknowns

# The data hardly distinguish rotation from translation, and errors between the two extend over the
# whole image. Only an accurate solution of the coarsest system removes them quickly.
COARSEST_GRID_SIDE = 2  # px: largest shorter side of the coarsest grid
COARSEST_SWEEPS = 32
# over-relaxation of the sweeps; 1 and 1.4 need more cycles, see bench/results/solvers.md
RELAXATION = 1.2


class Multigrid:
    """V-cycles over the unknowns of one level."""

    def __init__(
        self,
        unknowns: Unknowns,  # `cycle` and `descend` modify their `rho` in place
        system: LinearSystem,  # the system to solve; its tensor and weights are used without a copy
        *,
        solver: str,  # how the linear system of a pixel is solved
        relaxation: float = RELAXATION,  # over-relaxation of the sweeps, in (0, 2)
    ) -> None:
        grid = unknowns.grid
        self._levels = [_Level(unknowns, system, solver=solver, relaxation=relaxation)]
        while min(self._levels[-1].size) > COARSEST_GRID_SIDE:
            self._levels.append(self._levels[-1].coarser())
        self._solve_coarsest = self._levels[-1].bind_smooth(COARSEST_SWEEPS)
        self._previous = grid.allocate(unknowns.components)
        self._step = grid.allocate(unknowns.components)
        self.restart()

    def coarsen(self) -> None:
        """Compute the coarse systems; necessary whenever tensor or weights have changed."""
        for fine, coarse in zip(self._levels, self._levels[1:], strict=False):
            fine.coarsen(coarse)

    def restart(self) -> None:
        """Drop the last step and start at the present ρ̂; necessary if other code changed ρ̂."""
        finest = self._levels[0].unknowns
        finest.grid.copy(finest.rho, self._previous)
        self._step.fill(0)

    def descend(self) -> None:
        """Run one V-cycle, then minimise the energy over its correction and the last step.

        The minimum is taken in the plane of these two directions. For a fixed system this is the
        method of conjugate gradients, preconditioned by the cycle. The energy never rises.
        """
        self.cycle()
        finest = self._levels[0]
        finest.system.line_search(finest.unknowns.rho, self._previous, self._step)

    def cycle(self) -> None:
        """Run one V-cycle, V(1, 1)."""
        finer_levels = self._levels[:-1]
        for fine, coarse in zip(finer_levels, self._levels[1:], strict=True):
            fine.smooth()
            fine.restrict(coarse)
        self._solve_coarsest()
        for fine, coarse in zip(reversed(finer_levels), reversed(self._levels[1:]), strict=True):
            fine.add_correction(coarse)
            fine.smooth()


class _Level:
    """A grid, its system and its unknown: ρ̂ on the finest grid, a correction on coarser grids."""

    def __init__(
        self,
        unknowns: Unknowns,
        system: LinearSystem,
        source: LaneData | None = None,  # right-hand side of a correction
        *,
        solver: str,
        relaxation: float,
    ) -> None:
        self.unknowns, self.system, self._source = unknowns, system, source
        self._solver, self._relaxation = solver, relaxation
        grid = unknowns.grid
        self.size = grid.height, grid.width
        self.smooth = self.bind_smooth(1)
        self._column_weights = interpolation_columns(grid)
        # Strips of the coarser grid have an even width; half of a strip of this grid may be odd.
        self._halved_arrays: tuple[LaneData, LaneData, LaneData] | None = None
        if grid.strip_width // 2 != coarse_grid(grid).strip_width:
            self._halved_arrays = (
                _allocate_halved(grid, 6),
                _allocate_halved(grid, 2 * system.weights_per_edge),
                _allocate_halved(grid, system.components),
            )

    def bind_smooth(self, sweeps: int) -> Callable[[], None]:
        """Return a function that runs `sweeps` sweeps."""
        return self.system.bind_sweep(
            self.unknowns.rho,
            relaxation=self._relaxation,
            solver=self._solver,
            sweeps=sweeps,
            source=self._source,
        )

    def coarser(self) -> "_Level":
        """Return the level of half the density; `coarsen` computes its system."""
        grid = coarse_grid(self.unknowns.grid)
        camera = self.unknowns.camera.scaled(0.5, *self.size)
        unknowns = Unknowns(grid, camera, self.unknowns.components)
        system = replace(
            self.system,
            grid=grid,
            tensor=grid.allocate(6),
            weights=grid.allocate(2 * self.system.weights_per_edge),
            x_hat=unknowns.x_hat,
            y_hat=unknowns.y_hat,
        )
        source = grid.allocate(unknowns.components)
        return _Level(unknowns, system, source, solver=self._solver, relaxation=self._relaxation)

    def coarsen(self, coarse: "_Level") -> None:
        """Compute the system of the next coarser level."""
        if self._halved_arrays is None:
            self.system.coarsen(coarse.system.tensor, coarse.system.weights)
            return
        tensor, weights, _ = self._halved_arrays
        self.system.coarsen(tensor, weights)
        relayout(coarse.unknowns.grid, tensor, coarse.system.tensor)
        relayout(coarse.unknowns.grid, weights, coarse.system.weights)

    def restrict(self, coarse: "_Level") -> None:
        """Restrict the residual to the coarser level, and set its correction to zero."""
        coarse_source = coarse._source if self._halved_arrays is None else self._halved_arrays[2]
        self.system.restrict(self.unknowns.rho, coarse_source, source=self._source)
        if coarse_source is not coarse._source:
            relayout(coarse.unknowns.grid, coarse_source, coarse._source)
        coarse.unknowns.rho.fill(0)

    def add_correction(self, coarse: "_Level") -> None:
        """Add the correction of the coarser level."""
        correction = coarse.unknowns.rho
        if self._halved_arrays is not None:
            correction = self._halved_arrays[2]
            relayout(coarse.unknowns.grid, coarse.unknowns.rho, correction)
        add_correction(self.unknowns.grid, correction, self._column_weights, self.unknowns.rho)


def _allocate_halved(grid: LaneGrid, components: int) -> LaneData:
    return grid.place(aligned_zeros(halved_shape(grid, components)))
