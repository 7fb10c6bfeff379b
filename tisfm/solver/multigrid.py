"""Multigrid for the linear system of fixed weights (eq. 16, 22–23).

Sweeps take long over what is smooth; on a grid of half the density it is less smooth, and a sweep
costs a quarter. A V-cycle sweeps once, solves for the correction on the coarser grid in the same
way, adds it and sweeps once more.

The coarse system is that of averaged motion tensors at the coarse pixels' own x̂, ŷ, and of
averaged edge weights.
"""

import numpy as np

from tisfm.kernels.layout.lanes import LaneGrid, aligned_zeros
from tisfm.kernels.solve.coarsening import (
    coarse_grid,
    coarsen_system,
    correct,
    halved_shape,
    interpolation_columns,
    relayout,
    restrict_residual,
)
from tisfm.kernels.solve.line_search import descend, plane
from tisfm.kernels.solve.relaxation import sweep
from tisfm.solver.unknowns import Field, LaneData

# What tells rotation from translation is hardly seen by the data, and as large as the image: where
# the coarsest system is not solved to the end, all else waits for it.
COARSEST_SIDE = 2  # px
COARSEST_SWEEPS = 32
INDEPENDENT = 1e-5  # squared sine of the angle between directions, in the norm of the energy
RELAXATION = 1.2  # of the smoother: 1 and 1.4 take more cycles, see bench/results/solvers.md


class Multigrid:
    """V-cycles over one field.

    Parameters
    ----------
    field : Field
        Its `rho` is modified in place by `cycle` and `descend`.
    solver : {"cholesky", "closed_form"}
        How each pixel's system is solved.
    sets : int, optional
        Weights that an edge has: n, by default, or 1 for all components.
    relaxation : float
        Of the sweeps, in (0, 2).
    """

    def __init__(
        self,
        field: Field,
        *,
        solver: str,
        sets: int | None = None,
        relaxation: float = RELAXATION,
    ) -> None:
        self._solver, self._relaxation = solver, relaxation
        self._alpha: float | np.ndarray = 1.0
        self._before: LaneData | None = None
        self._step: LaneData | None = None
        self._levels = [_Level(field, sets or field.components)]
        while min(self._levels[-1].size) > COARSEST_SIDE:
            self._levels.append(self._levels[-1].coarser())

    def set_system(self, tensor: LaneData, weights: LaneData, alpha: float | np.ndarray) -> None:
        """Take the system whose solution is sought, and derive the coarse ones.

        Parameters
        ----------
        tensor : lane array, 6 components
            Motion tensor; kept, not copied.
        weights : lane array, 2·sets components
            Edge weights; kept, not copied.
        alpha : float or (n,) float32
            α_k = λ̂β s_k.
        """
        finest, *others = self._levels
        finest.tensor, finest.weights, self._alpha = tensor, weights, alpha
        for fine, coarse in zip(self._levels, others, strict=False):
            fine.coarsen(coarse)

    def restart(self) -> None:
        """Forget the last step, and take ρ̂ as it is now: due whenever others have changed it."""
        if self._before is None or self._step is None:
            grid, n = self._levels[0].field.grid, self._levels[0].field.components
            self._before, self._step = grid.allocate(n), grid.allocate(n)
        grid = self._levels[0].field.grid
        grid.copy(self._levels[0].field.rho, self._before)
        self._step.fill(0)

    def descend(self) -> None:
        """Run one V-cycle, then go to the least energy in the plane of its correction and the last.

        For one system these are conjugate gradients, which the cycle preconditions. The energy of
        the system does not rise, whatever it is.
        """
        if self._before is None or self._step is None:
            self.restart()
        finest = self._levels[0]
        field = finest.field
        self.cycle()
        matrix, vector = plane(
            field.grid,
            finest.tensor,
            finest.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            self._before,
            self._step,
            alpha=self._alpha,
        )
        p, q = _lowest(matrix, vector)
        descend(field.grid, p, q, field.rho, self._before, self._step)

    def cycle(self) -> None:
        """Run one V-cycle, V(1, 1)."""
        *above, coarsest = self._levels
        for fine, coarse in zip(above, self._levels[1:], strict=True):
            self._smooth(fine)
            fine.restrict(coarse, alpha=self._alpha)
        self._smooth(coarsest, COARSEST_SWEEPS)
        for fine, coarse in zip(reversed(above), reversed(self._levels[1:]), strict=True):
            fine.correct(coarse)
            self._smooth(fine)

    def _smooth(self, level: "_Level", sweeps: int = 1) -> None:
        field = level.field
        sweep(
            field.grid,
            level.tensor,
            level.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            alpha=self._alpha,
            relaxation=self._relaxation,
            solver=self._solver,
            sweeps=sweeps,
            source=level.source,
        )


class _Level:
    """A grid, its system and its unknown: ρ̂ on the finest, a correction of it on the others."""

    def __init__(self, field: Field, sets: int, source: LaneData | None = None) -> None:
        self.field, self.sets, self.source = field, sets, source
        grid, n = field.grid, field.components
        self.size = grid.height, grid.width
        self.tensor: LaneData | None = None
        self.weights: LaneData | None = None
        self._across = interpolation_columns(grid)
        # Strips of the coarser grid are even: half of ours may not be.
        aligned = grid.strip // 2 == coarse_grid(grid).strip
        self._halved: tuple[LaneData, LaneData, LaneData] | None = None
        if not aligned:
            self._halved = _halved(grid, 6), _halved(grid, 2 * sets), _halved(grid, n)

    def coarser(self) -> "_Level":
        grid, n = coarse_grid(self.field.grid), self.field.components
        field = Field(grid, self.field.camera.scaled(0.5, *self.size), n)
        level = _Level(field, self.sets, source=grid.allocate(n))
        level.tensor, level.weights = grid.allocate(6), grid.allocate(2 * self.sets)
        return level

    def coarsen(self, coarse: "_Level") -> None:
        """Derive the system of the next coarser level."""
        grid = self.field.grid
        if self._halved is None:
            coarsen_system(grid, self.tensor, self.weights, coarse.tensor, coarse.weights)
            return
        tensor, weights, _ = self._halved
        coarsen_system(grid, self.tensor, self.weights, tensor, weights)
        relayout(coarse.field.grid, tensor, coarse.tensor)
        relayout(coarse.field.grid, weights, coarse.weights)

    def restrict(self, coarse: "_Level", *, alpha: float | np.ndarray) -> None:
        """Hand the residual to the coarser level, whose correction starts from zero."""
        field = self.field
        halved = coarse.source if self._halved is None else self._halved[2]
        restrict_residual(
            field.grid,
            self.tensor,
            self.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            halved,
            alpha=alpha,
            source=self.source,
        )
        if halved is not coarse.source:
            relayout(coarse.field.grid, halved, coarse.source)
        coarse.field.rho.fill(0)

    def correct(self, coarse: "_Level") -> None:
        """Add what the coarser level found."""
        field, correction = self.field, coarse.field.rho
        if self._halved is not None:
            correction = self._halved[2]
            relayout(coarse.field.grid, coarse.field.rho, correction)
        correct(field.grid, correction, self._across, field.rho)


def _lowest(matrix: np.ndarray, vector: np.ndarray) -> tuple[float, float]:
    """Return the (p, q) of least zᵀ matrix z + 2 zᵀ vector; q is 0 where both are one direction."""
    (a, b), (_, c) = matrix
    if not a > 0:
        return 0.0, 0.0
    determinant = a * c - b * b
    if determinant > INDEPENDENT * a * c:
        p, q = np.linalg.solve(matrix, -vector)
        return float(p), float(q)
    return float(-vector[0] / a), 0.0


def _halved(grid: LaneGrid, components: int) -> LaneData:
    return grid.place(aligned_zeros(halved_shape(grid, components)))
