"""The Taichi side: every kernel, by its wrapper, on the arrays it would meet in the driver."""

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.problems import (
    ALPHA,
    CONSTRAINTS,
    CONTRAST,
    RATIO,
    RELAXATION,
    SCALES,
    UNIQUENESS,
    Problem,
)
from bench.references import mask_moments
from tisfm.field import Field, LaneData
from tisfm.interpolation import spline_taps
from tisfm.kernels import (
    claims,
    constraints,
    derivatives,
    evidence,
    flow,
    images,
    iteration,
    relaxation,
    transfer,
    warp,
)
from tisfm.kernels.lanes import LaneGrid, aligned_zeros, on_host

Timed = tuple[Callable[[], Any], Callable[[Any], np.ndarray]]


class Operations:
    """One method per kernel, which returns the call to be timed and a reader of its answer.

    The reader takes what the call returned and gives images, (k, H, W), or sums, (k, 1). Calls
    that work in place go on from where the last one ended, as they do in the solver. On a device,
    lane arrays are there before the call, and stay.
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
        self.field = Field(self.grid, problem.camera, components)
        self.field.rho = self.lay(problem.rho[:components])

    def image_to_lanes(self) -> Timed:
        image = self.problem.frames[0].astype(np.float32)
        out = self.grid.allocate(1, halo=images.IMAGE_HALO)
        return (
            lambda: images.image_to_lanes(self.grid, image, out),
            lambda _: self.read(out, halo=images.IMAGE_HALO),
        )

    def lanes_to_images(self) -> Timed:
        out = np.empty((self.n, self.problem.height, self.problem.width), np.float32)
        return lambda: images.lanes_to_images(self.grid, self.field.rho, out), lambda _: out

    def derivatives(self) -> Timed:
        frames = [self.grid.allocate(1, halo=images.IMAGE_HALO) for _ in range(2)]
        for frame, array in zip(self.problem.frames, frames, strict=True):
            images.image_to_lanes(self.grid, frame.astype(np.float32), array)
        halo = derivatives.DERIVATIVE_HALO
        out = self.grid.allocate(3, halo=halo)
        return (
            lambda: derivatives.derivatives(self.grid, *frames, out, scheme=self.scheme),
            lambda _: self.read(out, halo=halo)[:, halo:-halo, halo:-halo],
        )

    def flow(self) -> Timed:
        field, out = self.field, self.grid.allocate(2)
        return (
            lambda: flow.flow(self.grid, field.rho, field.x_hat, field.y_hat, out),
            lambda _: self.read(out),
        )

    def warp(self) -> Timed:
        frame = self.problem.frames[1].astype(np.float32)
        image, taps = self.grid.place(frame), self.grid.place(spline_taps(frame), vectors=True)
        motion, mask = self.lay(self.problem.flow), self.grid.allocate(1)
        halo = images.IMAGE_HALO
        out = self.grid.allocate(1, halo=halo)
        return (
            lambda: warp.warp(self.grid, image, taps, motion, out, mask),
            lambda _: np.concatenate(
                [self.read(out, halo=halo)[:, halo:-halo, halo:-halo], self.read(mask)]
            ),
        )

    def constancy_constraints(self) -> Timed:
        p = self.problem
        halo = derivatives.DERIVATIVE_HALO
        gradients = aligned_zeros(self.grid.shape(3, halo))
        for component, image in enumerate(p.gradients):
            padded = np.ascontiguousarray(image, np.float32)
            gradients[component] = self.lay_with_border(padded, halo)
        inputs = [
            self.grid.place(gradients),
            *(self.lay(array) for array in (p.flow, p.mask[None])),
        ]
        out, tensor = self.grid.allocate(9), self.grid.allocate(6)
        arguments, options = (self.grid, *inputs, out, tensor), {"scales": SCALES, **CONSTRAINTS}
        return (
            lambda: constraints.constancy_constraints(*arguments, **options),
            lambda _: np.concatenate([self.read(out), self.read(tensor)]),
        )

    def sweep(self) -> Timed:
        field = self.field
        arguments = (self.grid, *self._system(), field.x_hat, field.y_hat, field.rho)
        options = {"alpha": ALPHA, "relaxation": RELAXATION, "solver": self.solver}
        return lambda: relaxation.sweep(*arguments, **options), lambda _: self.read(field.rho)

    def advance(self) -> Timed:
        field, p = self.field, self.problem
        tensor, weights = self._system()
        previous = self.lay(p.previous[: self.n])
        tables = (field.edges, field.x_hat, field.y_hat)
        arguments = (
            self.grid,
            self.lay(p.constraints),
            *tables,
            field.rho,
            weights,
            tensor,
            previous,
        )
        options = {"alpha": ALPHA, "contrast": CONTRAST, "scales": SCALES}
        return (
            lambda: iteration.advance(*arguments, **options),
            lambda _: np.concatenate([self.read(tensor), self.read(weights)]),
        )

    def prolong(self) -> Timed:
        field = self.field
        coarse = self.problem.coarse[: self.n].astype(np.float32)
        return (
            lambda: transfer.prolong(self.grid, coarse, field.rho, ratio=RATIO),
            lambda _: self.read(field.rho),
        )

    def evidence(self) -> Timed:
        field, out = self.field, self.grid.allocate(7)
        arguments = (self.grid, *self._system(), field.x_hat, field.y_hat, field.rho, out)
        return lambda: evidence.evidence(*arguments, alpha=ALPHA), lambda _: self.read(out)

    def splat(self) -> Timed:
        arguments = self._arrivals()
        options = {"any_order": self.grid.on_device}
        return (
            lambda: claims.splat(*arguments, **options),
            lambda _: np.moveaxis(arguments[-1], -1, 0),
        )

    def defeated(self) -> Timed:
        arguments = self._arrivals()
        claims.splat(*arguments)
        out = np.empty((self.problem.height, self.problem.width), np.int32)
        return (
            lambda: claims.defeated(*arguments, out, **UNIQUENESS),
            lambda _: mask_moments(out),
        )

    def _arrivals(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        p = self.problem
        flow_images, residual = (array.astype(np.float32) for array in (p.flow, p.residual))
        return flow_images, residual, aligned_zeros((p.height, p.width, 4))

    def _system(self) -> tuple[LaneData, LaneData]:
        weights = self.problem.weights(self.n, joint=self.scheme == "joint")
        sets = weights.reshape(2, self.n, *weights.shape[1:])
        if self.scheme == "joint":
            sets = sets[:, :1]
        return self.lay(self.problem.tensor), self.lay(np.concatenate(sets))

    def lay(self, stack: np.ndarray) -> LaneData:
        """Lay (k, H, W) into a new lane array, halo columns included, without a kernel."""
        grid = self.grid
        out = aligned_zeros(grid.shape(len(stack)))
        array = out if grid.lanes > 1 else out[..., None]
        padded = np.pad(stack, ((0, 0), (0, 0), (0, grid.lanes * grid.strip - grid.width)))
        strips = padded.reshape(len(stack), grid.height, grid.lanes, grid.strip)
        array[:, 1:-1, 1:-1] = np.swapaxes(strips, 2, 3)
        array[:, 1:-1, 0, 1:] = array[:, 1:-1, -2, :-1]
        array[:, 1:-1, -1, :-1] = array[:, 1:-1, 1, 1:]
        return grid.place(out)

    def lay_with_border(self, image: np.ndarray, halo: int) -> np.ndarray:
        """Lay (H + 2·halo, W + 2·halo) into one component of a lane array, border included."""
        grid = self.grid
        columns = np.arange(grid.strip + 2 * halo)[:, None] + grid.strip * np.arange(grid.lanes)
        table = image[:, np.minimum(columns, image.shape[1] - 1)]
        return table if grid.lanes > 1 else table[..., 0]

    def read(self, array: LaneData, halo: int = 0) -> np.ndarray:
        """Return a lane array as (k, H, W) without a kernel; or, `halo` given, with its border."""
        grid = self.grid
        around = halo or 1
        x = np.arange(-halo, grid.width + halo)
        lane = np.clip(x // grid.strip, 0, grid.lanes - 1)
        array = on_host(array)
        rows = array if halo else array[:, 1:-1]
        return (rows if grid.lanes > 1 else rows[..., None])[
            :, :, x - lane * grid.strip + around, lane
        ]
