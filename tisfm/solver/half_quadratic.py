"""The half-quadratic algorithm (Table 1), within one linearisation.

ρ̂ are the unknowns of a pixel, and b are the weights of edges between neighbours. Equations and
tables are numbered as in the paper (docs/method.md). A lane array holds an image as vertical strips
(`tisfm.kernels.layout.lanes`).
"""

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

MIN_ITERATIONS = 2  # the first iteration spreads data over short distances only
# unknowns of the translation model, the smallest model with fields of ρ̂ whose flow is 0
TRANSLATION_COMPONENTS = 3
MIN_CONFIRMATIONS = 2  # consecutive iterations whose estimate of the remaining error must be small
# smallest assumed ratio of successive errors: for a while, changes may shrink faster than errors
MIN_CONTRACTION = 2 / 3


@dataclass(frozen=True, kw_only=True)
class Effort:
    """The number of iterations for a linearisation, and the condition to stop."""

    # outer_iterations, sweeps: largest number of half-quadratic iterations, and sweeps in each
    outer_iterations: int
    sweeps: int
    relaxation: float  # over-relaxation of the sweeps, in (0, 2)
    # Iterations stop when ‖change of ρ̂‖ ≤ tolerance · ‖ρ̂‖. If `is_thorough`, they stop when the
    # estimate of ‖error of ρ̂‖ is at most tolerance · ‖ρ̂‖.
    tolerance: float
    solver: str  # how the linear system of a pixel is solved
    cycles: int = 0  # multigrid cycles in place of sweeps; 0 for sweeps
    # Whether to iterate close to the minimum. This is needed with one pyramid level, since no
    # coarser level gives a good start. It takes at least three iterations, or four with sweeps.
    is_thorough: bool = False


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """Record of one half-quadratic iteration."""

    energy: float  # energy (eq. 6, 20) after the iteration; it never rises within a warp
    # half-quadratic energy (eq. 8, 21) with the weights of the system that was solved
    half_quadratic: float
    change: float  # ‖change of ρ̂‖ / ‖ρ̂‖; 0 if ρ̂ is zero


class HalfQuadratic:
    """Alternates b (eq. 10) and ρ̂ (eq. 16, 23) on one level.

    If other code changes ρ̂ or the constraints, call `update` before `minimise`: `update` computes
    weights and tensor anew. `minimise` itself keeps them up to date.
    """

    def __init__(
        self,
        unknowns: Unknowns,  # `minimise` modifies their `rho` in place
        # lane array, 3 components for each constraint: (p, q, c)
        # (`tisfm.kernels.data.constraints`); used without a copy
        constraints: LaneData,
        *,
        scales: Sequence[float],  # scales of the data terms (`tisfm.kernels.model.robust`)
        smoothness: Smoothness,
        effort: Effort,
    ) -> None:
        self._unknowns, self._constraints, self._scales = unknowns, constraints, scales
        self._contrast, self._effort = smoothness.contrast, effort
        grid, n = unknowns.grid, unknowns.components
        # with an infinite contrast, b is 1
        has_shared_weights = smoothness.joint or not np.isfinite(smoothness.contrast)
        has_flowless_fields = effort.is_thorough and n >= TRANSLATION_COMPONENTS
        self._flowless = FlowlessFields(unknowns) if has_flowless_fields else None
        self._previous = grid.allocate(n, zeros=False)  # ρ̂ at the last update
        self._set_system(
            LinearSystem(
                grid=grid,
                tensor=grid.allocate(6),
                weights=grid.allocate(2 if has_shared_weights else 2 * n),
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
        """Compute b and the data weights for the current ρ̂ and constraints."""
        return self._update()

    def minimise(self) -> tuple[list[Iteration], bool]:
        """Iterate at least twice, until ρ̂ hardly changes or the iterations run out.

        Returns the iterations, and whether the last relative change was within the tolerance. With
        `Effort.is_thorough`, it returns whether the estimated error was within the tolerance.
        """
        if self._effort.is_thorough:
            return self._minimise_to_error_bound()
        iterations: list[Iteration] = []
        solve = self._solver_step()
        for _ in range(self._effort.outer_iterations):
            solve()
            sums = self._update()
            iterations.append(_iteration_record(sums))
            is_settled = sums.change <= self._effort.tolerance * sums.size
            if len(iterations) >= MIN_ITERATIONS and is_settled:
                return iterations, True
        return iterations, False

    def _minimise_to_error_bound(self) -> tuple[list[Iteration], bool]:
        """Iterate until the estimated error is within the tolerance.

        Sweeps hardly reduce errors of low frequency. So once sweeps seem to have converged, one
        iteration uses multigrid instead, and its change must be within the tolerance too.
        """
        tolerance, uses_sweeps = self._effort.tolerance, self._effort.cycles == 0
        iterations: list[Iteration] = []
        changes: list[float] = []
        confirmations, has_new_rho = 0, True
        for _ in range(self._effort.outer_iterations):
            is_check = uses_sweeps and confirmations >= MIN_CONFIRMATIONS
            if is_check or not uses_sweeps:
                self._cycle(has_new_rho=has_new_rho)
            else:
                self._sweep()
            if self._flowless is not None:
                self._flowless.minimise(self.system)
            has_new_rho = uses_sweeps or self._flowless is not None
            iterations.append(_iteration_record(self._update()))
            changes.append(iterations[-1].change)
            if is_check:
                if changes[-1] <= tolerance:
                    return iterations, True
                confirmations = 0
                continue
            confirmations = confirmations + 1 if remaining_error(changes) <= tolerance else 0
            if confirmations >= MIN_CONFIRMATIONS and not uses_sweeps:
                return iterations, True
        return iterations, False

    def _set_system(self, system: LinearSystem) -> None:
        """Store a system and bind the functions that every iteration runs."""
        # Its weights are g·b of every edge; its tensor is the weighted sum of the data terms. With
        # one unknown, a pixel moves along its epipolar line only, and q is 0 in all constraints.
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

    def _solver_step(self) -> Callable[[], None]:
        """Return the function that brings ρ̂ nearer to the solution of the current system."""
        if not self._effort.cycles:
            return self._sweep
        self._get_multigrid().restart()
        return lambda: self._cycle(has_new_rho=False)

    def _cycle(self, *, has_new_rho: bool) -> None:
        """Run multigrid cycles; `has_new_rho` if other code changed ρ̂ since the last cycle."""
        multigrid = self._get_multigrid()
        if has_new_rho:
            multigrid.restart()
        multigrid.coarsen()
        for _ in range(max(self._effort.cycles, 1)):
            multigrid.descend()

    def _get_multigrid(self) -> Multigrid:
        if self._multigrid is None:
            self._multigrid = Multigrid(self._unknowns, self.system, solver=self._effort.solver)
        return self._multigrid


def remaining_error(changes: Sequence[float]) -> float:
    """Return an estimate of the error of ρ̂ from its last relative changes, one per iteration.

    If every change is q times the previous change, all later changes add up to q/(1 − q) times the
    last change. q is the greater of the last two ratios, but at least ⅔. The result is infinite if
    changes grow.
    """
    if not changes or changes[-1] == 0:
        return 0.0 if changes else math.inf
    if len(changes) == 1:
        return math.inf
    tail = changes[-3:]
    ratios = [
        change / previous if previous > 0 else math.inf for previous, change in pairwise(tail)
    ]
    contraction = max(*ratios, MIN_CONTRACTION)
    return changes[-1] * contraction / (1 - contraction) if contraction < 1 else math.inf


def _iteration_record(sums: Sums) -> Iteration:
    return Iteration(
        energy=sums.energy,
        half_quadratic=sums.half_quadratic,
        change=sums.change / sums.size if sums.size > 0 else 0.0,
    )
