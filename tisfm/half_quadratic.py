"""The half-quadratic algorithm (Table 1), within one linearisation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.field import Field
from tisfm.kernels.diffusivity import edge_weights
from tisfm.kernels.evidence import evidence
from tisfm.kernels.reductions import change, energy
from tisfm.kernels.relaxation import sweep
from tisfm.kernels.robust import robust_energy, robust_tensor
from tisfm.multigrid import Multigrid


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
        Of the data terms (`tisfm.kernels.robust`).
    stiffness : sequence of float
        s_k of each component.
    joint : bool
        Whether an edge is one for all components.

    Attributes
    ----------
    weights : lane array, 2n components
        s_k·g·b of every edge.
    tensor : lane array, 6 components
        The data terms, weighted and added up.
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
        self.field, self.alpha = field, alpha
        self.outer_iterations, self.sweeps, self.tolerance = outer_iterations, sweeps, tolerance
        self.relaxation, self.solver, self.scales = relaxation, solver, scales
        self._penalty = {"contrast": contrast, "stiffness": stiffness, "joint": joint}
        self.tensor = field.grid.allocate(6)
        self.weights = field.grid.allocate(2 * field.components)
        self._cycles = cycles
        self._multigrid = Multigrid(field, alpha=alpha, solver=solver) if cycles else None
        if not cycles:
            self._previous = field.grid.allocate(field.components)

    def update_weights(self, terms: np.ndarray) -> None:
        """Compute the auxiliary fields of the current ρ̂: b, and the weights of the data."""
        field = self.field
        edge_weights(field.grid, field.rho, field.edges, self.weights, **self._penalty)
        robust_tensor(
            field.grid, terms, field.x_hat, field.y_hat, field.rho, self.tensor, scales=self.scales
        )

    def evidence(self, terms: np.ndarray) -> np.ndarray:
        """Return J, the squared residual and M at the current ρ̂, (7, H, W) float32.

        See `tisfm.kernels.evidence`; the weights become those of the current ρ̂, and the residual
        is the robust one.
        """
        return self.field.to_images(self._evidence(terms))

    def residual(self, terms: np.ndarray) -> np.ndarray:
        """Return the squared residual alone, (H, W) float32."""
        return self.field.to_images(self._evidence(terms)[3:4])[0]

    def _evidence(self, terms: np.ndarray) -> np.ndarray:
        field = self.field
        self.update_weights(terms)
        out = field.grid.allocate(7)
        evidence(
            field.grid,
            self.tensor,
            self.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            out,
            alpha=self.alpha,
        )
        return out

    def minimise(self, terms: np.ndarray) -> tuple[list[Iteration], bool]:
        """Iterate until ρ̂ ceases to evolve, or the limit of iterations.

        Parameters
        ----------
        terms : lane array, 6 components for each data term
            Motion tensors.

        Returns
        -------
        iterations : list of Iteration
        converged : bool
            Whether the last relative change was within the tolerance.
        """
        iterations: list[Iteration] = []
        if self._multigrid:
            self._multigrid.restart()
        else:
            self._previous[...] = self.field.rho
        for _ in range(self.outer_iterations):
            self.update_weights(terms)
            moved, size = self._cycle(self._multigrid) if self._multigrid else self._sweep()
            total, half_quadratic = self._energies(terms)
            iterations.append(
                Iteration(
                    energy=total,
                    half_quadratic=half_quadratic,
                    change=moved / size if size > 0 else 0.0,
                )
            )
            if moved <= self.tolerance * size:
                return iterations, True
        return iterations, False

    def _sweep(self) -> tuple[float, float]:
        """Sweep, and return ‖change of ρ̂‖ and ‖ρ̂‖."""
        field = self.field
        sweep(
            field.grid,
            self.tensor,
            self.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            alpha=self.alpha,
            relaxation=self.relaxation,
            solver=self.solver,
            sweeps=self.sweeps,
        )
        return change(field.grid, field.rho, self._previous)

    def _cycle(self, multigrid: Multigrid) -> tuple[float, float]:
        """Run cycles, and return a bound of ‖change of ρ̂‖, and ‖ρ̂‖."""
        multigrid.set_system(self.tensor, self.weights)
        steps = [multigrid.descend() for _ in range(self._cycles)]
        return sum(moved for moved, _ in steps), steps[-1][1]

    def _energies(self, terms: np.ndarray) -> tuple[float, float]:
        """Return the energy and its half-quadratic form, with the weights as they are."""
        field = self.field
        data = robust_energy(
            field.grid, terms, field.x_hat, field.y_hat, field.rho, scales=self.scales
        )
        half_data, smoothness, half_smoothness = energy(
            field.grid,
            self.tensor,
            self.weights,
            field.edges,
            field.x_hat,
            field.y_hat,
            field.rho,
            alpha=self.alpha,
            **self._penalty,
        )
        return data + smoothness, half_data + half_smoothness
