"""Kernels and references of second-order smoothness: inverse depth D and its slopes."""

from functools import cached_property, partial

import numpy as np

from bench import reference
from bench.kernels.multigrid_steps import children, neighbours
from bench.kernels.sides import NumpySide, Run, TaichiSide, Timed
from bench.shared.problems import DATA_SCALES, RELAXATION, RHO_NOISE, Problem, in_single_precision
from tisfm.kernels.layout.lanes import LaneData
from tisfm.kernels.solve.coarsening import interpolation_columns
from tisfm.kernels.solve.second_order import coarsening, line_search
from tisfm.kernels.solve.second_order.system import SecondOrderSystem

SPACING = 2.0  # px between the pixels of the second level
STIFFNESS = {"alpha": 2.0, "beta": 30.0, "gamma": 0.1}
CONTRASTS = (0.5, 0.2, 0.7)  # px/frame, and per px
ANCHOR_SCALE = 0.4  # px/frame
ANCHOR_SHARE = 0.5  # share of the pixels with an anchor


class Surface:
    """An inverse depth with slopes, its previous state, and the system linearised there."""

    def __init__(self, problem: Problem) -> None:
        rng = np.random.default_rng(5)
        depth = problem.inverse_depth[0]
        true = np.stack([depth, *np.gradient(depth, SPACING, axis=(1, 0))])
        self.rho, self.previous, other = in_single_precision(
            true + RHO_NOISE * rng.normal(size=(3, *true.shape))
        )
        self.step = in_single_precision(self.rho - self.previous + other - true)
        weight = rng.uniform(0.1, 1, depth.shape) * (rng.uniform(size=depth.shape) < ANCHOR_SHARE)
        self.anchors = in_single_precision(
            np.stack([weight, depth + RHO_NOISE * rng.normal(size=depth.shape)])
        )
        self.smoothness = reference.SecondOrder(
            **STIFFNESS,
            contrasts=CONTRASTS,
            spacing=SPACING,
            edges=in_single_precision(rng.uniform(0.1, 2, (2, *depth.shape))),
        )
        self.tensor = in_single_precision(
            reference.anchor_tensor(self.previous[0], *self.anchors, ANCHOR_SCALE)
        )
        self.weights = in_single_precision(
            reference.second_order_weights(self.previous, self.smoothness)
        )
        # p and c of the constraints p D + c = 0: brightness, and both of its derivatives.
        self.lines = problem.constraints.reshape(3, 3, *depth.shape)[:, ::2]

    def residual(self, rho: np.ndarray, source: np.ndarray | None = None) -> np.ndarray:
        """Return the residual: right-hand side minus left-hand side, (3, H, W)."""
        return reference.second_order_residual(
            self.tensor, self.weights, rho, spacing=SPACING, source=source
        )


class SecondOrderOperations(TaichiSide):
    @cached_property
    def surface(self) -> Surface:
        return Surface(self.problem)

    def second_order_sweep(self) -> Timed:
        rho = self.lay(self.surface.rho)
        run = self._slope_system().bind_sweep(rho, relaxation=RELAXATION)
        return run, self.reader(rho)

    def second_order_update(self) -> Timed:
        surface, system = self.surface, self._slope_system()
        height, width = self.problem.height, self.problem.width
        run = system.bind_weight_update(
            self.lay(surface.rho),
            self.lay(surface.previous[:1]),
            self.lay(surface.anchors),
            self.lay(surface.smoothness.open(height, width)),
            self.lay(self.problem.constraints),
            contrasts=CONTRASTS,
            anchor_scale=ANCHOR_SCALE,
            scales=DATA_SCALES,
        )
        return run, self.reader(*system.arrays)

    def second_order_coarsen_system(self) -> Timed:
        system = self._slope_system()
        out = [self.halved(array.shape[0]) for array in system.arrays]
        return (
            system.bind_coarsen(*out),
            lambda _: np.concatenate([self.read_halved(array) for array in out]),
        )

    def second_order_restrict_residual(self) -> Timed:
        offsets = self.grid.place(coarsening.offset_columns(self.grid)[0])
        rho, out = self.lay(self.surface.rho), self.halved(3)
        run = self._slope_system().bind_restrict(offsets, rho, out)
        return run, lambda _: self.read_halved(out)

    def second_order_add_correction(self) -> Timed:
        grid, rho = self.grid, self.lay(self.surface.rho)
        coarse = self.lay_halved(self.problem.parents[:3])
        tables = (*interpolation_columns(grid), coarsening.offset_columns(grid)[1])
        near, far, outer = map(grid.place, tables)
        return partial(
            coarsening.add_correction, grid, coarse, (near, far, outer), rho, spacing=SPACING
        ), self.reader(rho)

    def second_order_plane_energy(self) -> Timed:
        surface = self.surface
        correction = surface.rho - surface.previous
        directions = map(self.lay, (correction, surface.previous, surface.step))
        arrays = self._slope_system().arrays
        return (
            line_search.bind_plane_energy(self.grid, arrays, SPACING / 2, *directions),
            lambda sums: np.concatenate([sums[0][np.triu_indices(2)], sums[1]])[:, None],
        )

    def _slope_system(self) -> SecondOrderSystem:
        tensor, weights = self.surface.tensor, self.surface.weights
        arrays: list[LaneData] = [self.lay(tensor), self.lay(weights.reshape(6, *tensor.shape[1:]))]
        return SecondOrderSystem(
            grid=self.grid, tensor=arrays[0], weights=arrays[1], spacing=SPACING, **STIFFNESS
        )


class SecondOrderReferences(NumpySide):
    @cached_property
    def surface(self) -> Surface:
        return Surface(self.problem)

    def second_order_sweep(self) -> Run:
        surface, rho = self.surface, self.surface.rho.copy()

        def run() -> np.ndarray:
            reference.second_order_sweep(
                surface.tensor, surface.weights, rho, spacing=SPACING, relaxation=RELAXATION
            )
            return rho

        return run

    def second_order_update(self) -> Run:
        surface = self.surface
        rho, depth, smoothness = surface.rho, surface.rho[0], surface.smoothness
        system_state, previous = (surface.tensor, surface.weights), surface.previous[0].copy()

        def run() -> np.ndarray:
            nonlocal system_state
            (a, b, c), weights = system_state
            reference.second_order_energy(rho, smoothness)
            reference.anchor_energy(depth, *surface.anchors, ANCHOR_SCALE)
            reference.second_order_half_quadratic(rho, weights, smoothness)
            ((a * depth + 2 * b) * depth + c).sum()
            np.linalg.norm(depth - previous), np.linalg.norm(depth)
            previous[...] = depth
            terms = surface.lines[:1], surface.lines[1:]
            _, tensor = reference.line_tensor(terms, depth, DATA_SCALES)
            tensor += reference.anchor_tensor(depth, *surface.anchors, ANCHOR_SCALE)
            weights = reference.second_order_weights(rho, smoothness)
            system_state = tensor, weights
            return np.concatenate([tensor, *weights])

        return run

    def second_order_coarsen_system(self) -> Run:
        tensor, weights = self.surface.tensor, self.surface.weights

        def run() -> np.ndarray:
            east = 0.5 * children(weights[:, 0])[:, 1].sum(axis=0)
            south = 0.5 * children(weights[:, 1])[1].sum(axis=0)
            edges = np.stack([east, south], axis=1)
            return np.concatenate([children(tensor).sum(axis=(0, 1)), *edges])

        return run

    def second_order_restrict_residual(self) -> Run:
        surface = self.surface
        rows, columns = (_offsets(size) for size in surface.rho.shape[1:])
        moments = SPACING * np.stack(np.broadcast_arrays(columns, rows[:, None]))

        def run() -> np.ndarray:
            residual = surface.residual(surface.rho)
            residual[1:] += moments * residual[0]
            return children(residual).sum(axis=(0, 1))

        return run

    def second_order_add_correction(self) -> Run:
        coarse, rho = self.problem.parents[:3], self.surface.rho.copy()

        def run() -> np.ndarray:
            columns = _integrate(coarse, rho.shape[2], slope=1)
            rho[...] += _integrate(columns, rho.shape[1], slope=2)
            return rho

        return run

    def second_order_plane_energy(self) -> Run:
        surface = self.surface

        def run() -> np.ndarray:
            directions = surface.rho - surface.previous, surface.step
            residual = surface.residual(surface.previous)
            # Minus the matrix times a direction.
            residual_changes = [surface.residual(step, np.zeros_like(step)) for step in directions]
            sums = [
                -(directions[i] * residual_changes[j]).sum() for i, j in ((0, 0), (0, 1), (1, 1))
            ]
            return np.array([*sums, *(-(step * residual).sum() for step in directions)])[:, None]

        return run


def _offsets(size: int) -> np.ndarray:
    """Return the offsets of children from their parents, fine pixels; 0 for an only child."""
    offsets = np.where(np.arange(size) % 2, 0.5, -0.5)
    offsets[-1] *= size % 2 == 0
    return offsets


def _integrate(coarse: np.ndarray, size: int, *, slope: int) -> np.ndarray:
    """Return D and its slopes, interpolated along one axis; D is the integral of the slope."""
    axis = 3 - slope
    shape = [-1 if k == axis - 1 else 1 for k in range(2)]
    parent, neighbour = neighbours(size, coarse.shape[axis])
    direction, offset = (values.reshape(shape) for values in (neighbour - parent, _offsets(size)))
    near, far = coarse.take(parent, axis), coarse.take(neighbour, axis)
    fine = 0.75 * near + 0.25 * far
    # −t(1 − t) H Δv/2, H = 2h and t = ¼; outside the outermost coarse pixels, along the slope.
    fine[0] -= 3 / 16 * SPACING * direction * (far[slope] - near[slope])
    fine[0] += SPACING * (direction == 0) * offset * near[slope]
    return fine
