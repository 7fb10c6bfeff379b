"""The half-quadratic algorithm (Table 1), within one linearisation."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.kernels.model.edges import component_table
from tisfm.kernels.solve.data_precision import evidence
from tisfm.kernels.solve.relaxation import sweeper
from tisfm.kernels.solve.weight_update import Sums, advancer
from tisfm.solver.multigrid import Multigrid
from tisfm.solver.unknowns import Field, LaneData

LEAST = 2  # iterations, if so many are allowed: the first alone brings nothing from afar


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

    Parameters
    ----------
    field : Field
        Its `rho` is modified in place by `minimise`.
    alpha : float
        α = λ̂β.
    contrast : float
        δ, px/frame; infinite for quadratic smoothness.
    outer_iterations, sweeps : int
    cycles : int
        Of multigrid, in place of sweeps; 0 for sweeps.
    relaxation, tolerance : float
    solver : {"cholesky", "closed_form"}
    scales : sequence of float
        Of the data terms (`tisfm.kernels.model.robust`).
    stiffness : sequence of float
        s_k of each component.
    joint : bool
        Whether an edge is one for all components.

    Attributes
    ----------
    weights : lane array, 2n components, or 2 where edges are joint
        g·b of every edge.
    tensor : lane array, 6 components
        The data terms, weighted and added up. With one unknown, those of constraints along a line.
    """

    def __init__(
        self,
        field: Field,
        *,
        alpha: float,
        contrast: float,
        outer_iterations: int,
        sweeps: int,
        relaxation: float,
        tolerance: float,
        solver: str,
        scales: Sequence[float],
        stiffness: Sequence[float],
        joint: bool,
        cycles: int = 0,
    ) -> None:
        self.field = field
        self.outer_iterations, self.sweeps, self.tolerance = outer_iterations, sweeps, tolerance
        self.relaxation, self.solver, self.scales = relaxation, solver, scales
        n = field.components
        self._penalty = {
            "contrast": contrast,
            "stiffness": component_table(stiffness, n, "stiffness"),
        }
        # Launches bound to their arrays: of sweeps, and of the renewal for certain constraints.
        self._relax: Callable[[], None] | None = None
        self._advance: tuple[LaneData, Callable[[], Sums]] | None = None
        self._alpha = math.nan
        self.alpha = alpha
        self.tensor = field.grid.allocate(6)
        shared = joint or not np.isfinite(contrast)  # then b is 1
        self.weights = field.grid.allocate(2 if shared else 2 * field.components)
        self._cycles = cycles
        self._multigrid: Multigrid | None = None
        self._previous: LaneData | None = None  # ρ̂ at the last renewal

    @property
    def alpha(self) -> float:
        """α = λ̂β; may be set."""
        return self._alpha

    @alpha.setter
    def alpha(self, value: float) -> None:
        if value == self._alpha:
            return
        self._alpha = value
        self._alphas = np.float32(value) * self._penalty["stiffness"]  # α_k
        self._relax = self._advance = None

    def evidence(self) -> np.ndarray:
        """Return J, the squared residual and M at the current ρ̂, (7, H, W) float32.

        See `tisfm.kernels.solve.data_precision`; the residual is the robust one.
        """
        return self.field.to_images(self._evidence())

    def residual(self) -> np.ndarray:
        """Return the squared residual alone, (H, W) float32."""
        return self.field.to_image(self._evidence(), 3)

    def _evidence(self) -> LaneData:
        field = self.field
        out = field.grid.allocate(7, zeros=False)
        evidence(
            field.grid,
            self.tensor,
            self.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            out,
            alpha=self._alphas,
        )
        return out

    def minimise(self, terms: LaneData, *, renewed: bool = False) -> tuple[list[Iteration], bool]:
        """Iterate until ρ̂ ceases to evolve, twice at least, or to the limit of iterations.

        Parameters
        ----------
        terms : lane array, 3 components for each constraint
            (p, q, c) (`tisfm.kernels.data.constraints`).
        renewed : bool
            Whether `weights` and `tensor` are those of the current ρ̂ and these constraints:
            since the last call ρ̂ is as it left it, and `DataTerm.linearise` wrote the tensor.

        Returns
        -------
        iterations : list of Iteration
        converged : bool
            Whether the last relative change was within the tolerance.
        """
        iterations: list[Iteration] = []
        renewed = renewed and self._previous is not None
        renew = self._advancer(terms)
        if not renewed:
            renew()
        if self._cycles:
            multigrid = self._multigrid = self._multigrid or self._hierarchy()
            multigrid.restart()
        else:
            relax = self._relax = self._relax or self._sweeper()
        for _ in range(self.outer_iterations):
            if self._cycles:
                multigrid.set_system(self.tensor, self.weights, self._alphas)
                for _ in range(self._cycles):
                    multigrid.descend()
            else:
                relax()
            sums = renew()
            iterations.append(
                Iteration(
                    energy=sums.energy,
                    half_quadratic=sums.half_quadratic,
                    change=sums.moved / sums.size if sums.size > 0 else 0.0,
                )
            )
            if len(iterations) >= LEAST and sums.moved <= self.tolerance * sums.size:
                return iterations, True
        return iterations, False

    def renew(self, terms: LaneData) -> Sums:
        """Compute the auxiliary fields of the current ρ̂, b and the weights of the data.

        `minimise` leaves them so.
        """
        return self._advancer(terms)()

    def release(self) -> None:
        """Let go of all that `minimise` keeps for its next call, the constraints among it."""
        self._relax = self._advance = self._previous = self._multigrid = None

    def _hierarchy(self) -> Multigrid:
        return Multigrid(self.field, solver=self.solver, sets=self.weights.shape[0] // 2)

    def _sweeper(self) -> Callable[[], None]:
        field = self.field
        return sweeper(
            field.grid,
            self.tensor,
            self.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            alpha=self._alphas,
            relaxation=self.relaxation,
            solver=self.solver,
            sweeps=self.sweeps,
        )

    def _advancer(self, terms: LaneData) -> Callable[[], Sums]:
        field = self.field
        if self._previous is None:
            self._previous = field.grid.allocate(field.components, zeros=False)
        if self._advance is None or self._advance[0] is not terms:
            advance = advancer(
                field.grid,
                terms,
                field.edges,
                field.x_hat,
                field.y_hat,
                field.rho,
                self.weights,
                self.tensor,
                self._previous,
                alpha=self.alpha,
                scales=self.scales,
                along_line=field.components == 1,
                **self._penalty,
            )
            self._advance = terms, advance
        return self._advance[1]
