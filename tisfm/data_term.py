"""What the images say: a motion tensor, renewed at every warp."""

import numpy as np

from tisfm.field import Field
from tisfm.kernels.derivatives import derivatives
from tisfm.kernels.images import IMAGE_HALO, image_to_lanes
from tisfm.kernels.lanes import LaneGrid
from tisfm.kernels.motion_tensor import brightness_tensor
from tisfm.kernels.warp import warp


class BrightnessTerm:
    """The squared brightness constraint (eq. 4) of a pair of grey frames.

    Parameters
    ----------
    grid : LaneGrid
    frame0, frame1 : (H, W) float32
        Grey levels.
    scheme : {"cube", "five_tap"}
        Derivatives.
    """

    def __init__(self, grid: LaneGrid, frame0: np.ndarray, frame1: np.ndarray, scheme: str) -> None:
        self._grid, self._frame1, self._scheme = grid, frame1, scheme
        self._lanes0 = grid.allocate(1, halo=IMAGE_HALO)
        self._lanes1 = grid.allocate(1, halo=IMAGE_HALO)
        self._warped = np.empty_like(frame1)
        self._derivatives = grid.allocate(3)
        self._mask = grid.allocate(1)
        self._flow = grid.allocate(2)
        self._tensor = grid.allocate(6)
        image_to_lanes(grid, frame0, self._lanes0)

    def linearise(self, field: Field) -> np.ndarray:
        """Warp frame 1 by the field's flow and return the motion tensor there.

        Returns
        -------
        lane array, 6 components
            J11, J12, J22, j1, j2, J_tt: overwritten by the next call.
        """
        grid = self._grid
        field.flow(self._flow)
        warp(grid, self._frame1, self._flow, self._warped, self._mask)
        image_to_lanes(grid, self._warped, self._lanes1)
        derivatives(grid, self._lanes0, self._lanes1, self._derivatives, scheme=self._scheme)
        brightness_tensor(grid, self._derivatives, self._flow, self._mask, self._tensor)
        return self._tensor
