"""The unknown ρ̂ on one level of the pyramid, in lanes."""

from functools import cached_property
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images
from tisfm.kernels.layout.lanes import LaneGrid, aligned_empty, aligned_zeros
from tisfm.kernels.model.flow import flow
from tisfm.kernels.solve.coarsening import correct, interpolation_columns
from tisfm.kernels.solve.prolongation import prolong

LaneData = Any  # a lane array: of NumPy, or ti.ndarray where arrays stay on a device


class Field:
    """ρ̂, zero at first, with the geometry of its level.

    Parameters
    ----------
    grid : LaneGrid
    camera : Camera
        The camera of this level.
    components : {6, 3, 2, 1}
        Rigid motion, translation, the image motion itself, or that along a known line.

    Attributes
    ----------
    grid, camera, components
        As given.
    rho : lane array, `components` components
        ρ̂, px/frame of this level.
    x_hat : column table
    y_hat : (H + 2,) float32
    """

    def __init__(self, grid: LaneGrid, camera: Camera, components: int) -> None:
        self.grid = grid
        self.camera = camera
        self.components = components
        cx, cy = camera.center_for(grid.height, grid.width)
        self.x_hat = grid.place(grid.columns((grid.column_index() - cx) / camera.focal))
        rows = aligned_zeros((grid.height + 2,))
        rows[1:-1] = (np.arange(grid.height) - cy) / camera.focal
        self.y_hat = grid.place(rows)
        self.rho = grid.allocate(components)

    @cached_property
    def edges(self) -> LaneData:
        """Lane array of 2 components: g of the eastern and the southern edge of every pixel.

        1, and 0 across the border, unless it is set to what the image says.
        """
        return self.grid.open_edges()

    def start_from(self, coarse: "Field", ratio: float) -> None:
        """Set ρ̂, which must be zero, from that of a coarser level.

        Parameters
        ----------
        coarse : Field
        ratio : float
            Sampling density of the coarser level over this one's.
        """
        grid = self.grid
        even = ratio == 0.5 and grid.height % 2 == grid.width % 2 == 0
        if not (even and grid.lanes > 1 and grid.strip == 2 * coarse.grid.strip):
            prolong(grid, coarse.images(), self.rho, ratio=ratio)
            return
        # Whole vectors of lanes, where every lane lies over a lane.
        across = interpolation_columns(grid)
        for table in across:
            table *= 2  # ρ̂ is in pixels of its level
        correct(grid, coarse.rho, across, self.rho)

    def set_images(self, rho: np.ndarray) -> None:
        """Set ρ̂ from (components, H, W) float32, px/frame of this level."""
        for component, values in enumerate(rho):
            image_to_lanes(self.grid, np.ascontiguousarray(values), self.rho, component=component)

    def flow(self, out: LaneData) -> LaneData:
        """Write the image motion (eq. 25) to a lane array of 2 components, and return it."""
        flow(self.grid, self.rho, self.x_hat, self.y_hat, out)
        return out

    def images(self) -> np.ndarray:
        """Return ρ̂ as (components, H, W) float32, px/frame of this level."""
        return self.to_images(self.rho)

    def to_images(self, array: LaneData) -> np.ndarray:
        """Return a lane array of this grid as (k, H, W) float32."""
        out = aligned_empty((array.shape[0], self.grid.height, self.grid.width))
        lanes_to_images(self.grid, array, out)
        return out

    def to_image(self, array: LaneData, component: int) -> np.ndarray:
        """Return one component of a lane array of this grid as (H, W) float32."""
        out = aligned_empty((1, self.grid.height, self.grid.width))
        lanes_to_images(self.grid, array, out, component=component)
        return out[0]
