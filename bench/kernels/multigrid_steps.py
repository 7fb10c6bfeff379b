"""Kernels and references of multigrid: transfer between two grids, and line search."""

from functools import partial

import numpy as np

from bench import reference
from bench.kernels.sides import NumpySide, Run, TaichiSide, Timed
from bench.shared.problems import ALPHA, LINE_STEPS
from tisfm.kernels.layout.lanes import LaneData
from tisfm.kernels.solve import coarsening, line_search


class MultigridOperations(TaichiSide):
    def coarsen_system(self) -> Timed:
        system = self.system()
        out = [self.halved(array.shape[0]) for array in (system.tensor, system.weights)]
        return (
            partial(system.coarsen, *out),
            lambda _: np.concatenate([self.read_halved(array) for array in out]),
        )

    def restrict_residual(self) -> Timed:
        system, rho, out = self.system(), self.unknowns.rho, self.halved(self.n)
        return partial(system.restrict, rho, out), lambda _: self.read_halved(out)

    def relayout(self) -> Timed:
        coarse = coarsening.coarse_grid(self.grid)
        array, out = self.lay_halved(self.problem.parents[: self.n]), coarse.allocate(self.n)
        return partial(coarsening.relayout, coarse, array, out), lambda _: self.read_halved(out)

    def add_correction(self) -> Timed:
        grid, rho = self.grid, self.unknowns.rho
        coarse = self.lay_halved(self.problem.parents[: self.n])
        column_weights = tuple(map(grid.place, coarsening.interpolation_columns(grid)))
        return partial(coarsening.add_correction, grid, coarse, column_weights, rho), self.reader(
            rho
        )

    def plane_energy(self) -> Timed:
        arrays, directions = self.system().arrays, self._directions()
        return (
            lambda: line_search.plane_energy(self.grid, arrays, *directions),
            lambda sums: np.concatenate([sums[0][np.triu_indices(2)], sums[1]])[:, None],
        )

    def move_to_minimum(self) -> Timed:
        directions = self._directions()
        return partial(
            line_search.move_to_minimum, self.grid, *LINE_STEPS, *directions
        ), self.reader(*directions)

    def _directions(self) -> tuple[LaneData, LaneData, LaneData]:
        p = self.problem
        correction = self.lay(p.rho[: self.n] - p.previous[: self.n])
        return correction, self.lay(p.previous[: self.n]), self.lay(p.step[: self.n])


class MultigridReferences(NumpySide):
    """The same steps in plain NumPy; `relayout` is a copy."""

    def coarsen_system(self) -> Run:
        tensor, n = self.problem.tensor, self.n
        east, south = self.weights()[:n], self.weights()[n:]
        if self.scheme == "joint":
            east, south = east[:1], south[:1]

        def run() -> np.ndarray:
            right, lower = children(east), children(south)
            return np.concatenate(
                [
                    children(tensor).sum(axis=(0, 1)),
                    0.5 * right[:, 1].sum(axis=0),
                    0.5 * lower[1].sum(axis=0),
                ]
            )

        return run

    def restrict_residual(self) -> Run:
        n, motion, weights = self.n, self.motion, ALPHA * self.weights()
        tensor = self.problem.tensor

        def run() -> np.ndarray:
            east, south = reference.differences(self.rho)
            east, south = weights[:n] * east, weights[n:] * south
            residual = east + south
            residual[:, :, 1:] -= east[:, :, :-1]
            residual[:, 1:] -= south[:, :-1]
            for row, slope in zip(motion, _slope(tensor, motion, self.rho), strict=True):
                residual -= row * slope
            return children(residual).sum(axis=(0, 1))

        return run

    def relayout(self) -> Run:
        return lambda: self.problem.parents[: self.n].copy()

    def add_correction(self) -> Run:
        coarse, rho = self.problem.parents[: self.n], self.rho.copy()
        height, width = rho.shape[1:]

        def run() -> np.ndarray:
            rows = _interpolate(coarse, height, axis=1)
            rho[...] += _interpolate(rows, width, axis=2)
            return rho

        return run

    def plane_energy(self) -> Run:
        p, n, motion, weights = self.problem, self.n, self.motion, ALPHA * self.weights()
        previous, last_step = p.previous[:n], p.step[:n]
        j11, j12, j22, *_ = p.tensor

        def run() -> np.ndarray:
            directions = self.rho - previous, last_step
            flows = [reference.flow(motion, step) for step in directions]
            edges = [np.concatenate(reference.differences(step)) for step in directions]
            slope = _slope(p.tensor, motion, previous)
            tension = weights * np.concatenate(reference.differences(previous))
            sums = []
            for i, j in ((0, 0), (0, 1), (1, 1)):
                (a, b), (c, d) = flows[i], flows[j]
                data = j11 * a * c + j12 * (a * d + b * c) + j22 * b * d
                sums.append(data.sum() + (weights * edges[i] * edges[j]).sum())
            for (a, b), edge in zip(flows, edges, strict=True):
                sums.append((slope[0] * a + slope[1] * b).sum() + (tension * edge).sum())
            return np.array(sums)[:, None]

        return run

    def move_to_minimum(self) -> Run:
        p, (first, second) = self.problem, LINE_STEPS
        previous, step = p.previous[: self.n].copy(), p.step[: self.n].copy()
        rho = self.rho - previous  # the correction, then the new solution

        def run() -> np.ndarray:
            step[...] = first * rho + second * step
            rho[...] = previous + step
            previous[...] = rho
            return np.concatenate([rho, previous, step])

        return run


def children(stack: np.ndarray) -> np.ndarray:
    """Return the children of every coarse pixel, 0 for a missing one, (2, 2, k, h, w)."""
    k, height, width = stack.shape
    padded = np.pad(stack, ((0, 0), (0, height % 2), (0, width % 2)))
    split = padded.reshape(k, padded.shape[1] // 2, 2, padded.shape[2] // 2, 2)
    return split.transpose(2, 4, 0, 1, 3)


def _slope(tensor: np.ndarray, motion: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Return half the gradient of the data term in the flow, J(u, v)ᵀ + j, (2, H, W)."""
    u, v = reference.flow(motion, rho)
    j11, j12, j22, j1, j2, _ = tensor
    return np.stack([j11 * u + j12 * v + j1, j12 * u + j22 * v + j2])


def neighbours(size: int, coarse_size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the parent of every fine pixel, and the neighbour of the parent on that side."""
    fine = np.arange(size)
    parent = fine // 2
    return parent, np.clip(parent + 2 * (fine % 2) - 1, 0, coarse_size - 1)


def _interpolate(coarse: np.ndarray, size: int, *, axis: int) -> np.ndarray:
    """Return ¾ of every fine pixel's parent and ¼ of its neighbour, along an axis."""
    parent, neighbour = neighbours(size, coarse.shape[axis])
    return 0.75 * coarse.take(parent, axis) + 0.25 * coarse.take(neighbour, axis)
