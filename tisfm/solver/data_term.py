"""What the images say: constraints on the flow, renewed at every warp."""

import numpy as np

from tisfm.kernels.data.constraints import constancy_constraints, constraint_count
from tisfm.kernels.data.derivatives import DERIVATIVE_HALO, derivatives
from tisfm.kernels.data.warp import warp
from tisfm.kernels.layout.images import IMAGE_HALO, image_to_lanes
from tisfm.kernels.layout.lanes import LaneGrid
from tisfm.solver.unknowns import LaneData


class DataTerm:
    """Constancy of brightness (eq. 4) and of its gradient, for a pair of grey frames.

    Parameters
    ----------
    grid : LaneGrid
    frame0, frame1 : (H, W) float32
        Grey levels.
    taps1 : ((H + 3)·W, 4) float32
        `tisfm.solver.sampling.spline_taps` of frame 1.
    scheme : {"cube", "five_tap"}
        Derivatives.
    brightness, gradient : float
        Weights of the two constraints.
    normalization : float or None
        ζ, grey levels per px.
    contrast : float
        ε, px/frame (grey levels where constraints are not normalised); infinite for a quadratic
        data term.

    Attributes
    ----------
    scales : tuple of float
        m ε² of each term in use, m its weight (`tisfm.kernels.model.robust`).
    constraints : int
        How many a pixel has.
    """

    def __init__(
        self,
        grid: LaneGrid,
        frame0: np.ndarray,
        frame1: np.ndarray,
        taps1: np.ndarray,
        *,
        scheme: str,
        brightness: float,
        gradient: float,
        normalization: float | None,
        contrast: float,
    ) -> None:
        self._grid, self._scheme = grid, scheme
        self._constraints = {
            "brightness": brightness,
            "gradient": gradient,
            "normalization": normalization,
        }
        self.scales = tuple(weight * contrast**2 for weight in (brightness, gradient) if weight > 0)
        self.constraints = constraint_count(brightness, gradient)
        self._frame1 = grid.place(frame1)
        self._taps1 = grid.place(taps1, vectors=True)
        self._lanes0 = grid.allocate(1, halo=IMAGE_HALO, zeros=False)
        self._lanes1 = grid.allocate(1, halo=IMAGE_HALO, zeros=False)
        self._derivatives = grid.allocate(3, halo=DERIVATIVE_HALO, zeros=False)
        self._mask = grid.allocate(1, zeros=False)
        self._terms = grid.allocate(3 * self.constraints, zeros=False)
        image_to_lanes(grid, frame0, self._lanes0)

    def linearise(self, flow: LaneData, tensor: LaneData | None = None) -> LaneData:
        """Warp frame 1 by a flow and return the constraints there.

        Parameters
        ----------
        flow : lane array, 2 components
            (u, v), px/frame.
        tensor : lane array, 6 components, optional
            Overwritten with their motion tensors, added up with the robust weights of this flow.

        Returns
        -------
        lane array, 3 components for each constraint
            (p, q, c) (`tisfm.kernels.data.constraints`): overwritten by the next call.
        """
        grid = self._grid
        warp(grid, self._frame1, self._taps1, flow, self._lanes1, self._mask)
        derivatives(grid, self._lanes0, self._lanes1, self._derivatives, scheme=self._scheme)
        constancy_constraints(
            grid,
            self._derivatives,
            flow,
            self._mask,
            self._terms,
            tensor,
            scales=self.scales,
            **self._constraints,
        )
        return self._terms
