"""Base classes of both sides of a benchmark: arrays in lanes for Taichi, images for NumPy."""

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.shared.problems import ALPHA, Problem
from tisfm.kernels.layout.lanes import LaneData, LaneGrid, aligned_zeros, on_host
from tisfm.kernels.solve.coarsening import coarse_grid, halved_shape
from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.solver.unknowns import Unknowns

Timed = tuple[Callable[[], Any], Callable[[Any], np.ndarray]]
Run = Callable[[], np.ndarray]


class TaichiSide:
    """One method per kernel; it returns the timed call and a function that reads its answer.

    The function takes the result of the call and returns images, (k, H, W), or sums, (k, …). Calls
    in place continue from the last state, as in the solver. On a device, lane arrays are allocated
    before the call and stay there.
    """

    def __init__(
        self,
        problem: Problem,
        lanes: int,
        components: int,
        *,
        scheme: str = "",
        solver: str = "",
        on_device: bool = False,
    ) -> None:
        self.problem, self.n, self.scheme, self.solver = problem, components, scheme, solver
        self.grid = LaneGrid(problem.height, problem.width, lanes, on_device=on_device)
        self.unknowns = Unknowns(self.grid, problem.camera, components)
        self.unknowns.rho = self.lay(problem.rho[:components])

    def system(self) -> LinearSystem:
        """Return the linear system of the problem, in lanes."""
        weights = self.problem.weights(self.n, joint=self.scheme == "joint")
        weight_sets = weights.reshape(2, self.n, *weights.shape[1:])
        if self.scheme == "joint":
            weight_sets = weight_sets[:, :1]
        return self.system_of(np.concatenate(weight_sets), self.n)

    def system_of(self, weights: np.ndarray, components: int) -> LinearSystem:
        """Return the linear system of `components` unknowns with weights, (2n or 2, H, W)."""
        return LinearSystem(
            grid=self.grid,
            tensor=self.lay(self.problem.tensor),
            weights=self.lay(weights),
            x_hat=self.unknowns.x_hat,
            y_hat=self.unknowns.y_hat,
            alpha=ALPHA,
            stiffness=(1.0,) * components,
        )

    def lay(self, stack: np.ndarray, strip: int = 0) -> LaneData:
        """Copy (k, H, W) to a new lane array with halo columns, without a kernel.

        `strip` is the number of columns per lane, by default that of the grid.
        """
        (k, height, width), lanes = stack.shape, self.grid.lanes
        strip = strip or self.grid.strip_width
        shape = (k, height + 2, strip + 2)
        out = aligned_zeros(shape if lanes == 1 else (*shape, lanes))
        array = out if lanes > 1 else out[..., None]
        padded = np.pad(stack, ((0, 0), (0, 0), (0, lanes * strip - width)))
        array[:, 1:-1, 1:-1] = np.swapaxes(padded.reshape(k, height, lanes, strip), 2, 3)
        array[:, 1:-1, 0, 1:] = array[:, 1:-1, -2, :-1]
        array[:, 1:-1, -1, :-1] = array[:, 1:-1, 1, 1:]
        return self.grid.place(out)

    def lay_with_border(self, image: np.ndarray, halo: int) -> np.ndarray:
        """Copy (H + 2·halo, W + 2·halo) to one component of a lane array with a border."""
        grid = self.grid
        columns = np.arange(grid.strip_width + 2 * halo)[:, None] + grid.strip_width * np.arange(
            grid.lanes
        )
        table = image[:, np.minimum(columns, image.shape[1] - 1)]
        return table if grid.lanes > 1 else table[..., 0]

    def read(self, array: LaneData, halo: int = 0, *, width: int = 0) -> np.ndarray:
        """Return a lane array as (k, H, W) without a kernel, with a border if `halo` is given.

        `width` is that of the image, by default the width of the grid.
        """
        array, lanes = on_host(array), self.grid.lanes
        border = halo or 1
        strip = array.shape[2] - 2 * border
        x = np.arange(-halo, (width or self.grid.width) + halo)
        lane = np.clip(x // strip, 0, lanes - 1)
        rows = array if halo else array[:, 1:-1]
        return (rows if lanes > 1 else rows[..., None])[:, :, x - lane * strip + border, lane]

    def reader(self, *arrays: LaneData) -> Callable[[Any], np.ndarray]:
        """Return a function that reads lane arrays as one stack of images."""
        return lambda _: np.concatenate([self.read(array) for array in arrays])

    def halved(self, components: int) -> LaneData:
        """Return zeros of half the density, in the layout of this grid."""
        return self.grid.place(aligned_zeros(halved_shape(self.grid, components)))

    def lay_halved(self, stack: np.ndarray) -> LaneData:
        """Copy (k, ⌈H/2⌉, ⌈W/2⌉) to an array of half the density."""
        return self.lay(stack, strip=self.grid.strip_width // 2)

    def read_halved(self, array: LaneData) -> np.ndarray:
        """Return an array of half the density as (k, ⌈H/2⌉, ⌈W/2⌉)."""
        return self.read(array, width=coarse_grid(self.grid).width)


class NumpySide:
    """One method per kernel; it returns the timed call, which returns the answer.

    Calls in place continue from the last state, as on the Taichi side.
    """

    def __init__(self, problem: Problem, components: int, scheme: str) -> None:
        self.problem, self.n, self.scheme = problem, components, scheme
        self.rho = problem.rho[:components]
        self.motion = problem.motion[:, :components]

    def weights(self) -> np.ndarray:  # (2n, H, W), one for each component even if joint
        return self.problem.weights(self.n, joint=self.scheme == "joint")
