"""The unknown ρ̂ on one level of the pyramid, as a lane array.

ρ̂ are the unknowns of a pixel, such as the components of its motion, in px/frame. Equations are
numbered as in the paper (docs/method.md). A lane array holds an image as vertical strips
(`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images
from tisfm.kernels.layout.lanes import LaneData, LaneGrid, aligned_empty, aligned_zeros
from tisfm.kernels.model.rigid_motion import flow
from tisfm.kernels.solve.coarsening import add_correction, interpolation_columns, prolong
from tisfm.kernels.solve.linear_system import LinearSystem


class Unknowns:
    """The unknown ρ̂, zero at first, with the geometry of its level."""

    def __init__(
        self,
        grid: LaneGrid,
        camera: Camera,  # the camera of this level
        # {6, 3, 2, 1}: for rigid motion, translation, image motion, or image motion along a known
        # line
        components: int,
    ) -> None:
        self.grid = grid
        self.camera = camera
        self.components = components
        cx, cy = camera.center_for(grid.height, grid.width)
        self.x_hat = grid.place(grid.columns((grid.column_index() - cx) / camera.focal))
        rows = aligned_zeros((grid.height + 2,))
        rows[1:-1] = (np.arange(grid.height) - cy) / camera.focal
        self.y_hat = grid.place(rows)  # (H + 2,) float32
        # lane array, `components` components: ρ̂, px/frame of this level
        self.rho = grid.allocate(components)

    @cached_property
    def edges(self) -> LaneData:
        """Lane array of 2 components: factor g of the eastern and the southern edge of a pixel.

        By default, g is 1, and 0 across the border. `tisfm.solver.smoothness.image_driven_factor`
        may replace it.
        """
        return self.grid.edge_mask()

    def start_from(
        self,
        coarse: "Unknowns",
        ratio: float,  # sampling density of the coarser level divided by the density of this level
    ) -> None:
        """Interpolate ρ̂ from a coarser level; ρ̂ must be zero before."""
        grid = self.grid
        is_half = ratio == 0.5 and grid.height % 2 == grid.width % 2 == 0
        if not (is_half and grid.lanes > 1 and grid.strip_width == 2 * coarse.grid.strip_width):
            prolong(grid, coarse.images(), self.rho, ratio=ratio)
            return
        # Every lane of this grid lies over one coarse lane, so whole vectors are interpolated.
        column_weights = interpolation_columns(grid)
        for table in column_weights:
            table *= 2  # ρ̂ is in pixels of its level
        add_correction(grid, coarse.rho, column_weights, self.rho)

    def set_images(self, rho: np.ndarray) -> None:
        """Set ρ̂ from (components, H, W) float32, px/frame of this level."""
        for component, values in enumerate(rho):
            self.set_image(component, values)

    def set_image(self, component: int, values: np.ndarray) -> None:
        """Set a component of ρ̂ from (H, W) float32, px/frame of this level."""
        image_to_lanes(self.grid, np.ascontiguousarray(values), self.rho, component=component)

    def move(
        self,
        step: Sequence[np.ndarray],  # two (H, W) float32: px/frame of this level
    ) -> None:
        """Add a step to the first two unknowns; their values displace a pixel directly."""
        for component, values in enumerate(step):
            self.set_image(component, self.to_image(self.rho, component) + values)

    def bind_flow(self, out: LaneData) -> Callable[[], None]:
        """Return a function that writes the image motion (eq. 25) to a 2-component lane array."""
        return flow.bind(self.grid, self.rho, self.x_hat, self.y_hat, out)

    def flow(self) -> np.ndarray:
        """Return the image motion (eq. 25), (2, H, W) float32, px/frame of this level."""
        out = self.grid.allocate(2, zeros=False)
        self.bind_flow(out)()
        return self.to_images(out)

    def precision(self, system: LinearSystem) -> np.ndarray:
        """Return the precision of each pixel's flow from data and from neighbours, (7, H, W).

        float32; see `tisfm.kernels.solve.data_precision`. The residual has robust weights.
        """
        return self.to_images(self._precision(system))

    def residual(self, system: LinearSystem) -> np.ndarray:
        """Return the squared residual of `precision`, (H, W) float32."""
        return self.to_image(self._precision(system), 3)

    def _precision(self, system: LinearSystem) -> LaneData:
        out = self.grid.allocate(7, zeros=False)
        system.precision(self.rho, out)
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
