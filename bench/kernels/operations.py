"""Wrapper calls of the kernels that compute a motion field from two frames."""

from functools import partial

import numpy as np

from bench.kernels.references import flow_and_flow_sum, mask_moments, previous_constraints
from bench.kernels.sides import TaichiSide, Timed
from bench.kernels.unfused import sweep_unfused
from bench.shared import problems
from tisfm.kernels.data import (
    constraints,
    derivatives,
    forward_splatting,
    image_edges,
    three_frames,
    warp,
)
from tisfm.kernels.layout import images
from tisfm.kernels.layout.lanes import aligned_zeros
from tisfm.kernels.model import readout, rigid_motion
from tisfm.kernels.solve import coarsening, data_precision, weight_update
from tisfm.solver.sampling import spline_taps


class FieldOperations(TaichiSide):
    def image_to_lanes(self) -> Timed:
        image = self.problem.frames[0].astype(np.float32)
        out = self.grid.allocate(1, halo=images.IMAGE_HALO)
        return (
            partial(images.image_to_lanes, self.grid, image, out),
            lambda _: self.read(out, halo=images.IMAGE_HALO),
        )

    def lanes_to_images(self) -> Timed:
        out = np.empty((self.n, self.problem.height, self.problem.width), np.float32)
        return partial(images.lanes_to_images, self.grid, self.unknowns.rho, out), lambda _: out

    def derivatives(self) -> Timed:
        frames = [self.grid.allocate(1, halo=images.IMAGE_HALO) for _ in range(2)]
        for frame, array in zip(self.problem.frames, frames, strict=True):
            images.image_to_lanes(self.grid, frame.astype(np.float32), array)
        halo = derivatives.DERIVATIVE_HALO
        out = self.grid.allocate(3, halo=halo)
        return (
            partial(derivatives.derivatives, self.grid, *frames, out, scheme=self.scheme),
            lambda _: self.read(out, halo=halo)[:, halo:-halo, halo:-halo],
        )

    def flow(self) -> Timed:
        unknowns, out = self.unknowns, self.grid.allocate(2)
        return partial(
            rigid_motion.flow, self.grid, unknowns.rho, unknowns.x_hat, unknowns.y_hat, out
        ), self.reader(out)

    def warp(self) -> Timed:
        frame = self.problem.frames[1].astype(np.float32)
        image, taps = self.grid.place(frame), self.grid.place(spline_taps(frame), vectors=True)
        motion, mask = self.lay(self.problem.flow), self.grid.allocate(1)
        halo = images.IMAGE_HALO
        out = self.grid.allocate(1, halo=halo)
        return (
            partial(warp.warp, self.grid, image, taps, motion, out, mask),
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
        arguments, options = (
            (self.grid, *inputs, out, tensor),
            {"scales": problems.DATA_SCALES, **problems.CONSTRAINTS},
        )
        return partial(constraints.constancy_constraints, *arguments, **options), self.reader(
            out, tensor
        )

    def backward_flow(self) -> Timed:
        arguments = [self.lay(array) for array in flow_and_flow_sum(self.problem.flow)]
        out = self.grid.allocate(2)
        return partial(three_frames.backward_flow, self.grid, *arguments, out), self.reader(out)

    def join(self) -> Timed:
        p = self.problem
        previous, trust, masks = previous_constraints(p)
        inputs = [self.lay(array) for array in (previous, trust, *masks[:, None], p.flow)]
        out, tensor = self.lay(p.constraints), self.grid.allocate(6)
        return partial(
            three_frames.join_constraints, self.grid, *inputs, problems.DATA_SCALES, out, tensor
        ), self.reader(out, tensor)

    def image_edges(self) -> Timed:
        image, out = self.problem.frames[0].astype(np.float32), self.grid.allocate(2)
        return partial(
            image_edges.image_edges, self.grid, image, out, rate=problems.EDGE_RATE
        ), self.reader(out)

    def multiply(self) -> Timed:
        factor, out = self.lay(self.problem.signs), self.lay(self.problem.constraints)
        return partial(images.multiply, self.grid, factor, out), self.reader(out)

    def sweep(self) -> Timed:
        system, rho = self.system(), self.unknowns.rho
        options = {"relaxation": problems.RELAXATION, "solver": self.solver}
        return partial(system.sweep, rho, **options), self.reader(rho)

    def sweep_unfused(self) -> Timed:
        if self.grid.lanes == 1:  # the sweep of the library is unfused then
            return self.sweep()
        system, rho = self.system(), self.unknowns.rho
        options = {"relaxation": problems.RELAXATION, "solver": self.solver}
        return partial(sweep_unfused, system, rho, **options), self.reader(rho)

    def update(self) -> Timed:
        unknowns, p, system = self.unknowns, self.problem, self.system()
        line = self.scheme == "line"
        run = system.bind_weight_update(
            unknowns.rho,
            self.lay(p.previous[: self.n]),
            self.lay(p.constraints),
            unknowns.edges,
            contrast=problems.CONTRAST,
            scales=problems.DATA_SCALES,
            along_line=line,
        )
        entries = list(weight_update.LINE_ENTRIES) if line else slice(None)
        return (
            run,
            lambda _: np.concatenate(
                [self.read(system.tensor)[entries], self.read(system.weights)]
            ),
        )

    def prolong(self) -> Timed:
        rho = self.unknowns.rho
        coarse = self.problem.coarse[: self.n].astype(np.float32)
        return partial(
            coarsening.prolong, self.grid, coarse, rho, ratio=problems.DENSITY_RATIO
        ), self.reader(rho)

    def data_precision(self) -> Timed:
        system, rho, out = self.system(), self.unknowns.rho, self.grid.allocate(7)
        return partial(system.precision, rho, out), self.reader(out)

    def share_of_data(self) -> Timed:
        p = self.problem
        precision, out = p.precision.astype(np.float32), np.empty((p.height, p.width), np.float32)
        options = {"half_share_residual": problems.TOLERATED_SQUARE, "freedom": 2}
        return partial(data_precision.share_of_data, precision, out, **options), lambda _: out[None]

    def motion_fields(self) -> Timed:
        p = self.problem
        cx, cy = p.camera.center_for(p.height, p.width)
        x_hat = ((np.arange(p.width) - cx) / p.camera.focal).astype(np.float32)
        y_hat = ((np.arange(p.height) - cy) / p.camera.focal).astype(np.float32)
        out = np.empty((3, p.height, p.width), np.float32)
        arguments = (p.rho[: self.n].astype(np.float32), x_hat, y_hat, out[:2], out[2])
        options = {"focal": p.camera.focal, "by_pixel": self.grid.on_device}
        return partial(readout.motion_fields, *arguments, **options), lambda _: out

    def splat(self) -> Timed:
        arguments = self._arrivals()
        options = {"any_order": self.grid.on_device}
        return (
            partial(forward_splatting.splat, *arguments, **options),
            lambda _: np.moveaxis(arguments[-1], -1, 0),
        )

    def hidden_pixels(self) -> Timed:
        arguments = self._arrivals()
        forward_splatting.splat(*arguments)
        out = np.empty((self.problem.height, self.problem.width), np.int32)
        return (
            partial(forward_splatting.hidden_pixels, *arguments, out, **problems.UNIQUENESS),
            lambda _: mask_moments(out),
        )

    def _arrivals(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        p = self.problem
        flow_images, residual = (array.astype(np.float32) for array in (p.flow, p.residual))
        return flow_images, residual, aligned_zeros((p.height, p.width, 4))
