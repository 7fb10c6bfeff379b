"""The half-quadratic algorithm (Table 1), within one linearisation."""

from dataclasses import dataclass

import numpy as np

from tisfm.field import Field
from tisfm.kernels.diffusivity import edge_weights
from tisfm.kernels.evidence import evidence
from tisfm.kernels.reductions import change, energy
from tisfm.kernels.relaxation import sweep


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
    relaxation, tolerance : float
    solver : {"cholesky", "closed_form"}
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
    ) -> None:
        self.field, self.alpha, self.contrast = field, alpha, contrast
        self.outer_iterations, self.sweeps, self.tolerance = outer_iterations, sweeps, tolerance
        self.relaxation, self.solver = relaxation, solver
        self.weights = field.grid.allocate(2 * field.components)
        self._previous = field.grid.allocate(field.components)

    def update_weights(self) -> None:
        """Compute the auxiliary field b of the current ρ̂."""
        field = self.field
        edge_weights(field.grid, field.rho, field.open_edges, self.weights, contrast=self.contrast)

    def evidence(self, tensor: np.ndarray) -> np.ndarray:
        """Return J, the squared residual and M at the current ρ̂, (7, H, W) float32.

        See `tisfm.kernels.evidence`; the weights become those of the current ρ̂.
        """
        field = self.field
        self.update_weights()
        out = field.grid.allocate(7)
        evidence(
            field.grid,
            tensor,
            self.weights,
            field.x_hat,
            field.y_hat,
            field.rho,
            out,
            alpha=self.alpha,
        )
        return field.to_images(out)

    def minimise(self, tensor: np.ndarray) -> tuple[list[Iteration], bool]:
        """Iterate until ρ̂ ceases to evolve, or the limit of iterations.

        Parameters
        ----------
        tensor : lane array, 6 components
            Motion tensor.

        Returns
        -------
        iterations : list of Iteration
        converged : bool
            Whether the last relative change was within the tolerance.
        """
        field = self.field
        grid = field.grid
        iterations: list[Iteration] = []
        self._previous[...] = field.rho
        for _ in range(self.outer_iterations):
            self.update_weights()
            sweep(
                grid,
                tensor,
                self.weights,
                field.x_hat,
                field.y_hat,
                field.rho,
                alpha=self.alpha,
                relaxation=self.relaxation,
                solver=self.solver,
                sweeps=self.sweeps,
            )
            moved, size = change(grid, field.rho, self._previous)
            data, smoothness, half_quadratic = energy(
                grid,
                tensor,
                self.weights,
                field.open_edges,
                field.x_hat,
                field.y_hat,
                field.rho,
                alpha=self.alpha,
                contrast=self.contrast,
            )
            iterations.append(
                Iteration(
                    energy=data + smoothness,
                    half_quadratic=data + half_quadratic,
                    change=moved / size if size > 0 else 0.0,
                )
            )
            if moved <= self.tolerance * size:
                return iterations, True
        return iterations, False
