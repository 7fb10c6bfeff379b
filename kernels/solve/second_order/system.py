"""The linear system for inverse depth D and its slopes, with fixed edge weights; its operations.

An edge joins two neighbouring pixels. Its energy is a r² + b |Δv|² + c (ΔD)², with r the part of ΔD
that the slopes v do not predict (`tisfm.kernels.solve.second_order`). A lane array holds an image
as vertical strips (`tisfm.kernels.layout.lanes`). A halved array belongs to the grid of half the
density (`tisfm.kernels.solve.coarsening`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from tisfm.kernels.layout.lanes import LaneData, LaneGrid
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.kernels.model.robust import check_constraints, component_table
from tisfm.kernels.solve.line_search import minimise_plane, move_to_minimum, subtract
from tisfm.kernels.solve.second_order.coarsening import coarsen_system, restrict_residual
from tisfm.kernels.solve.second_order.line_search import bind_plane_energy
from tisfm.kernels.solve.second_order.relaxation import bind_sweeps
from tisfm.kernels.solve.second_order.stencil import COMPONENTS, WEIGHTS
from tisfm.kernels.solve.second_order.weight_update import bind_update
from tisfm.kernels.solve.weight_update import Sums

PIVOT_FLOOR = (
    1e-6  # share of α and β added to pivots, for pixels without data and without neighbours
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondOrderSystem:
    """The equations of D, v₁ and v₂ at every pixel (`tisfm.kernels.solve.second_order`).

    The arrays are checked once, here. They are not copied: a change of an array changes the system.

    Raises TypeError, ValueError if an array does not fit the grid, or a number is not positive and
    finite.
    """

    grid: LaneGrid
    tensor: LaneData  # lane array, 3 components: A, B and C of the data, A D² + 2 B D + C
    # lane array, 6 components: a, b and c of the eastern and the southern edge: (a_E, a_S, b_E,
    # b_S, c_E, c_S)
    weights: LaneData
    # alpha, beta, gamma: strengths of the smoothness of r, Δv and ΔD, which are factors of a, b and
    # c on all edges; `gamma` may be 0
    alpha: float
    beta: float
    gamma: float = 0.0
    spacing: float = 1.0  # h, px of the finest level
    # px² of the finest level: a coarse pixel collects data of several fine pixels; this is the
    # variance of their positions along an axis; 0 on the finest grid
    spread: float = 0.0

    def __post_init__(self) -> None:
        self.grid.check(self.tensor, COMPONENTS, "tensor")
        self.grid.check(self.weights, WEIGHTS, "weights")
        for name in ("alpha", "beta", "spacing"):
            component_table([getattr(self, name)], 1, name)
        for name in ("gamma", "spread"):
            value = getattr(self, name)
            if not 0 <= value < float("inf"):
                raise ValueError(f"{name} is {value}: expected a number of at least 0")

    @property
    def arrays(self) -> tuple[LaneData, LaneData]:
        """Tensor and weights, the first two arguments of every kernel of a system."""
        return self.tensor, self.weights

    @cached_property
    def scalars(self) -> tuple[float, float, float, float]:
        """h/2, the spread of the data, and the floors of the pivots of D and of the slopes."""
        slope_floor = PIVOT_FLOOR * (self.beta + self.spacing**2 * self.alpha)
        return (
            self.spacing / 2,
            self.spread,
            PIVOT_FLOOR * self.alpha + MIN_DIVISOR,
            slope_floor + MIN_DIVISOR,
        )

    def bind_sweep(
        self,
        rho: LaneData,  # lane array, 3 components: D, v₁, v₂
        *,
        relaxation: float,  # in (0, 2); 1 is Gauss–Seidel
        sweeps: int = 1,
        # lane array, 3 components: right-hand side in place of (−B, 0, 0)
        source: LaneData | None = None,
    ) -> Callable[[], None]:
        """Return a function that runs full red–black sweeps, in place, halo included."""
        self._check(rho=rho, source=rho if source is None else source)
        return bind_sweeps(
            self.grid, self.arrays, self.scalars, rho, source, relaxation=relaxation, sweeps=sweeps
        )

    def bind_weight_update(
        self,
        rho: LaneData,
        previous: LaneData,
        anchors: LaneData,
        edges: LaneData,  # lane array, 2 components: g of the eastern and the southern edge
        constraints: LaneData | None = None,
        *,
        contrasts: Sequence[float],
        anchor_scale: float,
        scales: Sequence[float] = (),
    ) -> Callable[[], Sums]:
        """Return a function that writes weights and tensor for D, and returns sums over the image.

        The sums are energies, and the norms of D and of its change. An anchor (w, D*) of `anchors`
        is a known inverse depth D* of weight w; beyond a difference of `anchor_scale`, px/frame, it
        counts less. All arguments are those of
        `tisfm.kernels.solve.second_order.weight_update.bind_update`.
        """
        self._check(rho=rho)
        self.grid.check(previous, 1, "previous")
        self.grid.check(anchors, 2, "anchors")
        self.grid.check(edges, 2, "edges")
        if constraints is not None:
            check_constraints(self.grid, constraints, scales)
        elif len(scales):
            raise ValueError(f"scales is {tuple(scales)}: expected none without constraints")
        if len(contrasts) != 3 or not all(contrast > 0 for contrast in contrasts):
            raise ValueError(f"contrasts is {tuple(contrasts)}: expected 3 positive values")
        if not anchor_scale > 0:
            raise ValueError(f"anchor_scale is {anchor_scale}: expected a positive value, in px")
        slope_contrast, crease_contrast, jump_contrast = contrasts
        return bind_update(
            self.grid, self.arrays, rho, previous, anchors, edges, constraints,
            half_h=self.spacing / 2, stiffness=(self.alpha, self.beta, self.gamma),
            contrasts=(slope_contrast, crease_contrast, jump_contrast), anchor_scale=anchor_scale,
            scales=scales,
        )  # fmt: skip

    def bind_restrict(
        self,
        # offset of each column from the centre of its coarse column, in fine columns, as
        # `tisfm.kernels.solve.second_order.coarsening.offset_columns` returns it
        offsets: LaneData,
        rho: LaneData,  # lane array, 3 components
        out: LaneData,  # halved array, 3 components
        *,
        # lane array, 3 components: right-hand side in place of (−B, 0, 0)
        source: LaneData | None = None,
    ) -> Callable[[], None]:
        """Return a function that writes the residuals at `rho`, summed over children."""
        self._check(rho=rho, source=rho if source is None else source)
        return restrict_residual.bind(
            self.grid, self.arrays, self.scalars, offsets, rho, source, out
        )

    def bind_coarsen(
        self,
        # tensor, weights: halved arrays, 3 and 6 components
        tensor: LaneData,
        weights: LaneData,
    ) -> Callable[[], None]:
        """Return a function that writes the system of the grid of half the density."""
        return coarsen_system.bind(self.grid, self.arrays, tensor, weights)

    def bind_line_search(
        self,
        # rho, previous, step: lane arrays, 3 components: the corrected field, the field before the
        # correction, and the last step. Modified in place: `rho` and `previous` become the minimum,
        # `step` becomes the move to it.
        rho: LaneData,
        previous: LaneData,
        step: LaneData,
    ) -> Callable[[], None]:
        """Return a function that minimises the energy over a correction and the last step."""
        self._check(rho=rho, previous=previous, step=step)
        compute_correction = subtract.bind(self.grid, previous, rho)
        compute_energy = bind_plane_energy(
            self.grid, self.arrays, self.spacing / 2, rho, previous, step
        )

        def run() -> None:
            compute_correction()
            move_to_minimum(self.grid, *minimise_plane(*compute_energy()), rho, previous, step)

        return run

    def _check(self, **unknowns: LaneData) -> None:
        for name, array in unknowns.items():
            self.grid.check(array, COMPONENTS, name)
