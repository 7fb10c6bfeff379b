"""The linear system for ρ̂, the unknowns of every pixel, with fixed weights; its operations.

Equations are numbered as in the paper (docs/method.md). A lane array holds an image as vertical
strips (`tisfm.kernels.layout.lanes`). A halved array belongs to the grid of half the density
(`tisfm.kernels.solve.coarsening`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tisfm.kernels.layout.lanes import LaneData, LaneGrid
from tisfm.kernels.model.robust import check_constraints, component_table
from tisfm.kernels.solve.coarsening import coarsen_system, restrict_residual
from tisfm.kernels.solve.data_precision import data_precision
from tisfm.kernels.solve.line_search import line_search
from tisfm.kernels.solve.relaxation import bind_sweeps
from tisfm.kernels.solve.weight_update import Sums, bind_update


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearSystem:
    """(GᵀJG + diag α_k b̄_k) ρ̂ = Σ α_k b_k,N ρ̂_N − Gᵀj at every pixel (eq. 16, 22–23).

    N are its four neighbours, b_k,N the weight of unknown k on the edge to N, and b̄_k their sum.
    G ρ̂ is the flow; J and j are the motion tensor of the data.

    The arrays are checked once, here. They are not copied: a change of an array changes the system.

    Raises TypeError, ValueError if an array does not fit the grid, or alpha or a stiffness is not
    positive and finite.
    """

    grid: LaneGrid
    tensor: LaneData  # lane array, 6 components: motion tensor (J11, J12, J22, j1, j2, J_tt)
    # lane array, 2n components, or 2 if all unknowns share them: weights of the eastern edges, then
    # of the southern edges: g·b, from the image and the unknowns (`tisfm.kernels.model.robust`)
    weights: LaneData
    x_hat: LaneData  # normalised column coordinate x/f
    y_hat: LaneData  # (H + 2,) float32: normalised row coordinate y/f; row 0 is the halo
    alpha: float  # α, the strength of the smoothness: λ̂β of the paper
    # s_k, with α_k = α s_k; one for each unknown of a pixel
    stiffness: Sequence[float] | np.ndarray

    def __post_init__(self) -> None:
        grid = self.grid
        grid.check(self.tensor, 6, "tensor")
        grid.check(self.weights, self.weights.shape[0], "weights")
        if self.weights.shape[0] not in (2, 2 * self.components):
            raise ValueError(
                f"weights has {self.weights.shape[0]} components: expected 2, or 2 for each of "
                f"{self.components} unknowns"
            )
        grid.check_columns(self.x_hat, "x_hat")
        grid.check_rows(self.y_hat, "y_hat")
        component_table(self.alphas, self.components, "alpha")

    @property
    def components(self) -> int:
        """Unknowns at a pixel, n."""
        return len(self.stiffness)

    @property
    def weights_per_edge(self) -> int:
        """Number of weights per edge: n, or 1 if all components share it."""
        return int(self.weights.shape[0]) // 2

    @cached_property
    def alphas(self) -> np.ndarray:
        """α_k, (n,) float32."""
        return np.float32(self.alpha) * component_table(
            self.stiffness, self.components, "stiffness"
        )

    @cached_property
    def arrays(self) -> tuple[LaneData, ...]:
        """Tensor, weights, x̂, ŷ and α_k, the first five arguments of every kernel of a system."""
        return self.tensor, self.weights, self.x_hat, self.y_hat, self.alphas

    def sweep(
        self,
        rho: LaneData,  # lane array, n components: ρ̂, px/frame
        *,
        relaxation: float,  # in (0, 2); 1 is Gauss–Seidel
        solver: str = "cholesky",
        sweeps: int = 1,
        # lane array, n components: right-hand side c in place of −Gᵀj; j is then not read
        source: LaneData | None = None,
    ) -> None:
        """Run full red–black sweeps; `rho` is modified in place, halo included."""
        self.bind_sweep(rho, relaxation=relaxation, solver=solver, sweeps=sweeps, source=source)()

    def bind_sweep(
        self,
        rho: LaneData,
        *,
        relaxation: float,
        solver: str = "cholesky",
        sweeps: int = 1,
        source: LaneData | None = None,
    ) -> Callable[[], None]:
        """Return a function that runs sweeps as `sweep` does."""
        self._check(rho=rho, source=rho if source is None else source)
        return bind_sweeps(
            self.grid, self.arrays, rho, source, relaxation=relaxation, solver=solver, sweeps=sweeps
        )

    def bind_weight_update(
        self,
        rho: LaneData,
        previous: LaneData,
        constraints: LaneData,
        edges: LaneData,  # lane array, 2 components: g of the eastern and the southern edge
        *,
        contrast: float,
        scales: Sequence[float],
        along_line: bool = False,
    ) -> Callable[[], Sums]:
        """Return a function that writes weights and tensor for ρ̂, and returns sums over the image.

        The sums are energies, and the norms of ρ̂ and of its change. `along_line` says that a pixel
        can only move along its epipolar line: then q is 0 in all constraints (p, q, c). All
        arguments are those of `tisfm.kernels.solve.weight_update.bind_update`.
        """
        self._check(rho=rho, previous=previous)
        self.grid.check(edges, 2, "edges")
        check_constraints(self.grid, constraints, scales)
        return bind_update(
            self.grid, self.arrays, rho, previous, constraints, edges, alpha=self.alpha,
            stiffness=component_table(self.stiffness, self.components, "stiffness"),
            contrast=contrast, scales=scales, along_line=along_line,
        )  # fmt: skip

    def precision(self, rho: LaneData, out: LaneData) -> None:
        """Write precision and residual of the data, and the covariance given the neighbours.

        See `tisfm.kernels.solve.data_precision.data_precision`.
        """
        self._check(rho=rho)
        self.grid.check(out, 7, "out")
        data_precision(self.grid, self.arrays, rho, out)

    def restrict(
        self,
        rho: LaneData,  # lane array, n components
        out: LaneData,  # halved array, n components
        *,
        # lane array, n components: right-hand side c in place of −Gᵀj
        source: LaneData | None = None,
    ) -> None:
        """Write the residuals at `rho`, summed over the children of every coarse pixel."""
        self._check(rho=rho, source=rho if source is None else source)
        restrict_residual(self.grid, self.arrays, rho, source, out)

    def coarsen(
        self,
        # tensor, weights: halved arrays, 6 and 2 · `weights_per_edge` components
        tensor: LaneData,
        weights: LaneData,
    ) -> None:
        """Write the system of the grid of half the density."""
        coarsen_system(self.grid, self.arrays, tensor, weights)

    def line_search(
        self,
        # rho, previous, step: lane arrays, n components: the corrected ρ̂, ρ̂ before the correction,
        # and the last step. Modified in place: `rho` and `previous` become the minimum, `step`
        # becomes the move to it.
        rho: LaneData,
        previous: LaneData,
        step: LaneData,
    ) -> None:
        """Move to the minimum of the energy in the plane of the correction and the last step."""
        self._check(rho=rho, previous=previous, step=step)
        line_search(self.grid, self.arrays, rho, previous, step)

    def _check(self, **unknowns: LaneData) -> None:
        for name, array in unknowns.items():
            self.grid.check(array, self.components, name)
