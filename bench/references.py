"""The NumPy side: every kernel's step by `tisfm.reference`, or in plain NumPy where it has none."""

from collections.abc import Callable

import numpy as np

from bench.problems import ALPHA, CONSTRAINTS, RATIO, RELAXATION, SCALES, SMOOTHNESS, Problem
from tisfm import reference

Run = Callable[[], np.ndarray]


class References:
    """One method per kernel, which returns the call to be timed; the call returns the answer.

    Calls that work in place go on from where the last one ended, like those they stand beside.
    """

    def __init__(self, problem: Problem, components: int, option: str) -> None:
        self.problem, self.n, self.option = problem, components, option
        self.rho = problem.rho[:components]
        self.motion = problem.motion[:, :components]

    def image_to_lanes(self) -> Run:
        image = self.problem.frames[0]
        return lambda: np.pad(image, 4, mode="edge")[None]  # the border alone: no lanes here

    def lanes_to_images(self) -> Run:
        return lambda: self.rho.copy()  # a copy alone: there are no lanes to leave

    def derivatives(self) -> Run:
        return lambda: np.array(reference.derivatives(*self.problem.frames, self.option))

    def flow(self) -> Run:
        return lambda: reference.flow(self.motion, self.rho)

    def warp(self) -> Run:
        image, flow = self.problem.frames[1], self.problem.flow
        return lambda: np.array(reference.warp(image, flow))

    def constancy_tensors(self) -> Run:
        p = self.problem
        arguments = (tuple(p.gradients), p.flow, p.mask)
        return lambda: np.concatenate(reference.constancy_tensors(*arguments, **CONSTRAINTS))

    def robust_tensor(self) -> Run:
        arguments = (np.split(self.problem.terms, 2), self.motion, self.rho)
        return lambda: reference.robust_tensor(*arguments, SCALES)

    def robust_energy(self) -> Run:
        arguments = (np.split(self.problem.terms, 2), self.motion, self.rho)
        return lambda: np.array([[reference.robust_energy(*arguments, SCALES)]])

    def edge_weights(self) -> Run:
        return lambda: reference.edge_weights(self.rho, SMOOTHNESS)

    def sweep(self) -> Run:
        arguments = (self.problem.tensor, self.motion, self.problem.weights(self.n))
        rho = self.rho.copy()

        def run() -> np.ndarray:
            reference.sweep_red_black(*arguments, rho, alpha=ALPHA, relaxation=RELAXATION)
            return rho

        return run

    def energy(self) -> Run:
        arguments = (self.problem.tensor, self.motion, self.rho)
        weights = self.problem.weights(self.n)

        def run() -> np.ndarray:
            plain = reference.energy(*arguments, ALPHA, SMOOTHNESS)
            half = reference.half_quadratic_energy(*arguments, weights, ALPHA, SMOOTHNESS)
            return np.array([[plain], [half]])

        return run

    def change(self) -> Run:
        previous = self.problem.previous[: self.n].copy()

        def run() -> np.ndarray:
            norms = np.array([np.linalg.norm(self.rho - previous), np.linalg.norm(self.rho)])
            previous[...] = self.rho
            return norms[:, None]

        return run

    def prolong(self) -> Run:
        p = self.problem
        coarse, shape = p.coarse[: self.n], (p.height, p.width)
        return lambda: reference.prolong(coarse, shape, RATIO)

    def evidence(self) -> Run:
        n, motion = self.n, self.motion
        tensor, weights = self.problem.tensor, self.problem.weights(n)

        def run() -> np.ndarray:
            u, v = reference.flow(motion, self.rho)
            j11, j12, j22, j1, j2, jtt = tensor
            residual = j11 * u * u + 2 * j12 * u * v + j22 * v * v + 2 * (j1 * u + j2 * v) + jtt
            total = weights[:n] + weights[n:]
            total[:, :, 1:] += weights[:n, :, :-1]
            total[:, 1:] += weights[n:, :-1]
            covariance = np.einsum("ckyx,kyx,dkyx->cdyx", motion, 1 / (ALPHA * total), motion)
            m11, m12, m22 = covariance[0, 0], covariance[0, 1], covariance[1, 1]
            return np.array([j11, j12, j22, residual, m11, m12, m22])

        return run
