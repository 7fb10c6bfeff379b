"""What the images say: motion tensors, renewed at every warp."""

import numpy as np

from tisfm.field import LaneData
from tisfm.kernels.derivatives import DERIVATIVE_HALO, derivatives
from tisfm.kernels.images import IMAGE_HALO, image_to_lanes
from tisfm.kernels.lanes import LaneGrid
from tisfm.kernels.motion_tensor import constancy_tensors
from tisfm.kernels.warp import warp


class DataTerm:
    """Constancy of brightness (eq. 4) and of its gradient, for a pair of grey frames.

    Parameters
    ----------
    grid : LaneGrid
    frame0, frame1 : (H, W) float32
        Grey levels.
    taps1 : ((H + 3)·W, 4) float32
        `tisfm.interpolation.spline_taps` of frame 1.
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
        m ε² of each term in use, m its weight (`tisfm.kernels.robust`).
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
        self._frame1 = grid.place(frame1)
        self._taps1 = grid.place(taps1, vectors=True)
        self._lanes0 = grid.allocate(1, halo=IMAGE_HALO)
        self._lanes1 = grid.allocate(1, halo=IMAGE_HALO)
        self._derivatives = grid.allocate(3, halo=DERIVATIVE_HALO)
        self._mask = grid.allocate(1)
        self._terms = grid.allocate(6 * len(self.scales))
        image_to_lanes(grid, frame0, self._lanes0)

    def linearise(self, flow: LaneData) -> LaneData:
        """Warp frame 1 by a flow and return the motion tensors there.

        Parameters
        ----------
        flow : lane array, 2 components
            (u, v), px/frame.

        Returns
        -------
        lane array, 6 components for each term
            J11, J12, J22, j1, j2, J_tt: overwritten by the next call.
        """
        grid = self._grid
        warp(grid, self._frame1, self._taps1, flow, self._lanes1, self._mask)
        derivatives(grid, self._lanes0, self._lanes1, self._derivatives, scheme=self._scheme)
        constancy_tensors(
            grid, self._derivatives, flow, self._mask, self._terms, **self._constraints
        )
        return self._terms
