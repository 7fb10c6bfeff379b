"""The half-quadratic algorithm (Table 1), within one linearisation."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tisfm.kernels.layout.lanes import LaneData
from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.kernels.solve.weight_update import Sums
from tisfm.solver.flowless import FlowlessFields
from tisfm.solver.multigrid import Multigrid
from tisfm.solver.smoothness import Smoothness
from tisfm.solver.unknowns import Unknowns

FEWEST_ITERATIONS = 2  # if so many are allowed: the first alone brings nothing from afar
TRANSLATION = 3  # unknowns of the smallest model that has motions without image motion
CONFIRMED = 2  # iterations in a row whose estimate of the error left has to be small
LEAST_CONTRACTION = 2 / 3  # least factor assumed for errors: at first, changes may shrink faster


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How far a linearisation is solved.

    Attributes
    ----------
    outer_iterations, sweeps : int
        Half-quadratic iterations at most, and sweeps in each.
    cycles : int
        Of multigrid, in place of sweeps; 0 for sweeps.
    relaxation : float
        Of the sweeps, in (0, 2).
    tolerance : float
        Iterations stop when ‖change of ρ̂‖ ≤ tolerance · ‖ρ̂‖; where `thorough`, when ‖error of ρ̂‖
        is estimated to be no more than that.
    thorough : bool
        Whether ρ̂ has to come near the minimum, as with one pyramid level, where no coarser level
        brings it near. It takes three iterations at least, or four with sweeps.
    solver : {"cholesky", "closed_form"}
    """

    outer_iterations: int
    sweeps: int
    relaxation: float
    tolerance: float
    solver: str
    cycles: int = 0
    thorough: bool = False


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """Record of one half-quadratic iteration.

    Attributes
    ----------
    energy : float
        Energy (eq. 6, 20) after it; never rises within a warp.
    half_quadratic : float
        Its half-quadratic form (eq. 8, 21), with the weights the iteration solved for.
    change : float
        ‖change of ρ̂‖ / ‖ρ̂‖; 0 where ρ̂ is zero.
    """

    energy: float
    half_quadratic: float
    change: float


class HalfQuadratic:
    """Alternates b (eq. 10) and ρ̂ (eq. 16, 23) on one level.

    `update` has to come before `minimise` whenever ρ̂ or the constraints were changed by others:
    it makes weights and tensor those of both. `minimise` leaves them so.

    Parameters
    ----------
    unknowns : Unknowns
        Their `rho` is modified in place by `minimise`.
    constraints : lane array, 3 components for each constraint
        (p, q, c) (`tisfm.kernels.data.constraints`), read where they lie.
    scales : sequence of float
        Of the data terms (`tisfm.kernels.model.robust`).
    smoothness : Smoothness
    effort : Effort

    Attributes
    ----------
    system : LinearSystem
        Its weights are g·b of every edge, its tensor the data terms, weighted and added up; with
        one unknown, those of constraints along a line.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        constraints: LaneData,
        *,
        scales: Sequence[float],
        smoothness: Smoothness,
        effort: Effort,
    ) -> None:
        self._unknowns, self._constraints, self._scales = unknowns, constraints, scales
        self._contrast, self._effort = smoothness.contrast, effort
        grid, n = unknowns.grid, unknowns.components
        shared = smoothness.joint or not np.isfinite(smoothness.contrast)  # then b is 1
        rigid = effort.thorough and n >= TRANSLATION
        self._flowless = FlowlessFields(unknowns) if rigid else None
        self._previous = grid.allocate(n, zeros=False)  # ρ̂ at the last update
        self._set_system(
            LinearSystem(
                grid=grid,
                tensor=grid.allocate(6),
                weights=grid.allocate(2 if shared else 2 * n),
                x_hat=unknowns.x_hat,
                y_hat=unknowns.y_hat,
                alpha=smoothness.alpha,
                stiffness=smoothness.stiffness,
            )
        )

    def set_alpha(self, alpha: float) -> None:
        """Change α, the strength of the smoothness."""
        if alpha != self.system.alpha:
            self._set_system(replace(self.system, alpha=alpha))

    def update(self) -> Sums:
        """Compute the weights of the current ρ̂ and constraints: b, and those of the data."""
        return self._update()

    def minimise(self) -> tuple[list[Iteration], bool]:
        """Iterate until ρ̂ ceases to evolve, twice at least, or to the limit of iterations.

        Returns
        -------
        iterations : list of Iteration
        converged : bool
            Whether the last relative change was within the tolerance; where thorough, whether the
            error is estimated to be.
        """
        if self._effort.thorough:
            return self._minimise_thoroughly()
        iterations: list[Iteration] = []
        solve = self._solving()
        for _ in range(self._effort.outer_iterations):
            solve()
            sums = self._update()
            iterations.append(_recorded(sums))
            settled = sums.moved <= self._effort.tolerance * sums.size
            if len(iterations) >= FEWEST_ITERATIONS and settled:
                return iterations, True
        return iterations, False

    def _minimise_thoroughly(self) -> tuple[list[Iteration], bool]:
        """Iterate until little error is left.

        Sweeps hardly reduce errors of low frequency. Where sweeps seem to have converged, one
        iteration of multigrid replaces them, and it has to change little as well.
        """
        tolerance, sweeping = self._effort.tolerance, self._effort.cycles == 0
        iterations: list[Iteration] = []
        changes: list[float] = []
        confirmed, fresh = 0, True
        for _ in range(self._effort.outer_iterations):
            checking = sweeping and confirmed >= CONFIRMED
            if checking or not sweeping:
                self._cycle(fresh=fresh)
            else:
                self._sweep()
            if self._flowless is not None:
                self._flowless.minimise(self.system)
            fresh = sweeping or self._flowless is not None
            iterations.append(_recorded(self._update()))
            changes.append(iterations[-1].change)
            if checking:
                if changes[-1] <= tolerance:
                    return iterations, True
                confirmed = 0
                continue
            confirmed = confirmed + 1 if error_left(changes) <= tolerance else 0
            if confirmed >= CONFIRMED and not sweeping:
                return iterations, True
        return iterations, False

    def _set_system(self, system: LinearSystem) -> None:
        """Take a system, and bind to it what every iteration runs."""
        self.system = system
        self._multigrid: Multigrid | None = None
        self._update: Callable[[], Sums] = system.bind_weight_update(
            self._unknowns.rho,
            self._previous,
            self._constraints,
            self._unknowns.edges,
            contrast=self._contrast,
            scales=self._scales,
            along_line=self._unknowns.components == 1,
        )
        self._sweep = system.bind_sweep(
            self._unknowns.rho,
            relaxation=self._effort.relaxation,
            solver=self._effort.solver,
            sweeps=self._effort.sweeps,
        )

    def _solving(self) -> Callable[[], None]:
        """Return what comes nearer to the solution of the system of the current weights."""
        if not self._effort.cycles:
            return self._sweep
        self._with_multigrid().restart()
        return lambda: self._cycle(fresh=False)

    def _cycle(self, *, fresh: bool) -> None:
        """Run cycles of multigrid; `fresh` where others have changed ρ̂ since the last."""
        multigrid = self._with_multigrid()
        if fresh:
            multigrid.restart()
        multigrid.coarsen()
        for _ in range(max(self._effort.cycles, 1)):
            multigrid.descend()

    def _with_multigrid(self) -> Multigrid:
        if self._multigrid is None:
            self._multigrid = Multigrid(self._unknowns, self.system, solver=self._effort.solver)
        return self._multigrid


def error_left(changes: Sequence[float]) -> float:
    """Return an estimate of the error of ρ̂ from its last relative changes, one an iteration.

    If every change is q times the one before, the changes to come add up to q/(1 − q) times the
    last. q is the greater of the last two ratios, and ⅔ at least. Infinite if changes grow.
    """
    if not changes or changes[-1] == 0:
        return 0.0 if changes else math.inf
    if len(changes) == 1:
        return math.inf
    last = changes[-3:]
    ratios = [later / earlier if earlier > 0 else math.inf for earlier, later in pairwise(last)]
    contraction = max(*ratios, LEAST_CONTRACTION)
    return changes[-1] * contraction / (1 - contraction) if contraction < 1 else math.inf


def _recorded(sums: Sums) -> Iteration:
    """Return the record of an iteration."""
    return Iteration(
        energy=sums.energy,
        half_quadratic=sums.half_quadratic,
        change=sums.moved / sums.size if sums.size > 0 else 0.0,
    )
