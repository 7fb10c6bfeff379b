"""Kernels and references of rigid motions."""

from functools import partial

import numpy as np

from bench import reference
from bench.kernels.sides import NumpySide, Run, TaichiSide, Timed
from bench.shared import problems
from bench.shared.problems import Problem, in_single_precision
from tisfm.kernels.layout.lanes import LaneData, aligned_zeros
from tisfm.kernels.model import MIN_DIVISOR, readout
from tisfm.kernels.rigid import (
    census,
    epipolar,
    motion_system,
    outline_sweep,
    plane_sweep,
    semi_global,
    shared_depth,
)
from tisfm.reconstruction.depth.settings import DEPTH

DEPTH_WEIGHT = 3.0  # weight of the smoothness of depth while the motion changes
MIN_CURVATURE = 1e-6  # of the costs around the cheapest hypothesis


class DepthOperations(TaichiSide):
    def displacement(self) -> Timed:
        arguments, out = self._geometry(), [self.grid.allocate(2) for _ in range(2)]
        options = self._motions()
        return partial(epipolar.displacement, self.grid, *arguments, *out, **options), self.reader(
            *out
        )

    def restrict_to_line(self) -> Timed:
        p = self.problem
        flow, direction = np.split(displacement_of(p), 2)
        inputs = [self.lay(array) for array in (p.constraints, flow, direction, p.inverse_depth)]
        out = self.grid.allocate(len(p.constraints))
        return partial(epipolar.restrict_to_line, self.grid, *inputs, out), self.reader(out)

    def add_depth_terms(self) -> Timed:
        p = self.problem
        flow, direction = np.split(displacement_of(p), 2)
        arrays = p.tensor, flow, direction, p.inverse_depth, p.trust[None]
        inputs, out = [self.lay(array) for array in arrays], self.grid.allocate(3)
        return partial(shared_depth.add_depth_terms, self.grid, *inputs, out), self.reader(out)

    def depth_constraint(self) -> Timed:
        sums, out = self.lay(restricted_sums(self.problem)), self.grid.allocate(3)
        return partial(shared_depth.depth_constraint, self.grid, sums, out), self.reader(out)

    def squared_residual(self) -> Timed:
        p, out = self.problem, self.grid.allocate(1)
        inputs = [self.lay(array) for array in (p.tensor, displacement_of(p)[:2])]
        return partial(shared_depth.squared_residual, self.grid, *inputs, out), self.reader(out)

    def add_frame(self) -> Timed:
        p = self.problem
        inverse_depth, _, *tables = self._geometry()
        arguments = self.lay(p.tensor), inverse_depth, self.lay(p.trust[None]), *tables
        slopes, sums = self.grid.allocate(6), self.grid.allocate(2)
        motion = np.ascontiguousarray(p.motions[0], np.float32)
        options = {"number": 0, "motion": motion, "focal": p.camera.focal}
        options["quarter_weight_residual"] = tolerated_square(p)
        return partial(
            shared_depth.add_frame, self.grid, *arguments, slopes, sums, **options
        ), np.column_stack

    def eliminate_depth(self) -> Timed:
        slopes, sums = (self.lay(array) for array in shared_sums(self.problem))
        return partial(
            shared_depth.eliminate_depth, self.grid, slopes, sums, depth_stiffness=DEPTH_WEIGHT
        ), np.column_stack

    def motion_system(self) -> Timed:
        p = self.problem
        inverse_depth, labels, *_ = self._geometry()
        arguments = (
            self.system_of(p.weights(1), 1),
            self.lay(p.constraints),
            inverse_depth,
            labels,
        )
        options = {
            "label": 0,
            "scales": problems.DATA_SCALES,
            "depth_stiffness": DEPTH_WEIGHT,
            "quarter_weight_residual": problems.TOLERATED_SQUARE,
        }
        options |= self._motions()
        return partial(motion_system.motion_system, *arguments, **options), np.column_stack

    def matching_cost(self) -> Timed:
        p = self.problem
        arrays = []
        for features in p.features:
            arrays.append(aligned_zeros((p.height, p.width, 4)))
            arrays[-1][..., :3] = np.moveaxis(features, 0, -1)
        out = aligned_zeros(self._in_vectors())
        arguments = [array.astype(np.float32) for array in (p.guess, p.trust, p.motions[0])]
        options = {
            "center": p.camera.center_for(p.height, p.width),
            "focal": p.camera.focal,
            "first": problems.HYPOTHESES[0],
            "step": problems.HYPOTHESES[1] - problems.HYPOTHESES[0],
            "guess_distance": problems.GUESS_TRUNCATION,
        }
        return (
            partial(plane_sweep.matching_cost, *arrays, *arguments, out, **options),
            lambda _: np.moveaxis(out.reshape(p.cost.shape) * p.certain, -1, 0),
        )

    def census_cost(self) -> Timed:
        p, out = self.problem, aligned_zeros(self._in_vectors())
        options = {
            "center": p.camera.center_for(p.height, p.width),
            "focal": p.camera.focal,
            "first": problems.HYPOTHESES[0],
            "step": problems.HYPOTHESES[1] - problems.HYPOTHESES[0],
        }
        motion = p.motions[0].astype(np.float32)
        return (
            partial(census.census_cost, *p.census, motion, out, **options),
            lambda _: np.moveaxis(out.reshape(p.cost.shape) * p.rounds_clearly, -1, 0),
        )

    def census_transform(self) -> Timed:
        frame = np.ascontiguousarray(self.problem.frames[0], np.float32)
        is_used, out = np.ones(frame.shape, np.int32), np.empty(frame.shape, np.int32)
        return partial(outline_sweep.census_transform, frame, is_used, out), lambda _: out[None]

    def outline_cost(self) -> Timed:
        p, out = self.problem, aligned_zeros(self._in_vectors())
        key, others = p.outline_codes[0], np.ascontiguousarray(p.outline_codes[1:])
        motions = np.repeat(p.motions[:1], len(others), axis=0).astype(np.float32)
        guess, is_free = p.guess.astype(np.float32), (p.guess > np.median(p.guess)).astype(np.int32)
        options = {
            "origin": (0, 0),
            "center": p.camera.center_for(p.height, p.width),
            "focal": p.camera.focal,
            "first": problems.HYPOTHESES[0],
            "step": problems.HYPOTHESES[1] - problems.HYPOTHESES[0],
        }
        options |= problems.OUTLINE_COSTS
        return (
            partial(
                outline_sweep.outline_cost, key, others, motions, guess, is_free, out, **options
            ),
            lambda _: np.moveaxis(out.reshape(p.cost.shape) * p.rounds_clearly, -1, 0),
        )

    def aggregate(self) -> Timed:
        p = self.problem
        cost, out = (aligned_zeros(self._in_vectors()) for _ in range(2))
        cost[...] = p.cost.reshape(cost.shape)
        guide = p.features[0, 0].astype(np.float32)
        return (
            partial(semi_global.aggregate, cost, guide, out, **problems.AGGREGATION),
            lambda _: np.moveaxis(out.reshape(p.cost.shape), -1, 0),
        )

    def best_hypothesis(self) -> Timed:
        p = self.problem
        cost, out = aligned_zeros(p.cost.shape), np.empty((p.height, p.width), np.float32)
        cost[...] = p.cost
        return (
            partial(semi_global.best_hypothesis, cost, out, count=len(problems.HYPOTHESES)),
            lambda _: out[None],
        )

    def rigid_fields(self) -> Timed:
        p, grid = self.problem, self.grid
        depth, labels = p.inverse_depth[0].astype(np.float32), p.labels.astype(np.int32)
        tables = (-p.motion[0, 2, 0], -p.motion[1, 2, :, 0])
        fields = [np.empty((n, p.height, p.width), np.float32) for n in (2, 6)]
        arguments = (depth, labels, *(table.astype(np.float32) for table in tables), *fields)
        options = self._motions() | {"twists": p.twists, "by_pixel": grid.on_device}
        return (
            partial(readout.rigid_fields, *arguments, **options),
            lambda _: np.concatenate(fields),
        )

    def _in_vectors(self) -> tuple[int, ...]:
        """Return the shape of costs of all hypotheses, in lanes."""
        p, lanes = self.problem, self.grid.lanes
        shape = (p.height, p.width, len(problems.HYPOTHESES) // lanes)
        return shape if lanes == 1 else (*shape, lanes)

    def _geometry(self) -> tuple[LaneData, ...]:
        p, unknowns = self.problem, self.unknowns
        tables = unknowns.x_hat, unknowns.y_hat
        return self.lay(p.inverse_depth), self.lay(p.labels[None]), *tables

    def _motions(self) -> dict:
        p = self.problem
        return {"motions": p.motions.astype(np.float32), "focal": p.camera.focal}


class DepthReferences(NumpySide):
    def displacement(self) -> Run:
        return lambda: displacement_of(self.problem)

    def restrict_to_line(self) -> Run:
        p = self.problem
        displacement = displacement_of(p)
        terms = p.constraints.reshape(-1, 3, p.height, p.width)

        def run() -> np.ndarray:
            u, v, a, b = displacement
            depth = p.inverse_depth[0]
            out = np.zeros_like(terms)
            out[:, 0] = terms[:, 0] * a + terms[:, 1] * b
            out[:, 2] = terms[:, 0] * u + terms[:, 1] * v + terms[:, 2] - out[:, 0] * depth
            return out.reshape(-1, p.height, p.width)

        return run

    def add_depth_terms(self) -> Run:
        p = self.problem
        flow, direction = np.split(displacement_of(p), 2)
        sums = np.zeros((3, p.height, p.width))

        def run() -> np.ndarray:
            nonlocal sums
            restricted = reference.restrict_to_line(
                [p.tensor], flow, direction, p.inverse_depth[0]
            )[0]
            sums = sums + p.trust * restricted[[0, 3, 5]]
            return sums

        return run

    def depth_constraint(self) -> Run:
        square, product, _ = restricted_sums(self.problem)

        def run() -> np.ndarray:
            root = np.sqrt(np.maximum(square, MIN_DIVISOR))
            return np.stack([np.sqrt(np.maximum(square, 0)), 0 * square, product / root])

        return run

    def squared_residual(self) -> Run:
        p, flow = self.problem, displacement_of(self.problem)[:2]
        identity = reference.motion_matrix(p.camera, p.height, p.width, 2)
        return lambda: np.maximum(reference.residual(p.tensor, identity, flow), 0)[None]

    def add_frame(self) -> Run:
        p = self.problem
        pose, limit = (p.motions[0, :, :3], p.motions[0, :, 3]), tolerated_square(p)

        def run() -> np.ndarray:
            weighted_tensor = p.tensor * p.trust / (1 + squared_residuals(p) / limit) ** 2
            equations = reference.frame_equations(
                weighted_tensor, p.inverse_depth[0], p.camera, *pose
            )
            return np.column_stack(equations[:2])

        return run

    def eliminate_depth(self) -> Run:
        slopes, sums = shared_sums(self.problem)
        rows, (curvature, gradient) = slopes.reshape(len(slopes), -1), sums.reshape(2, -1)

        def run() -> np.ndarray:
            answer = rows / (curvature + DEPTH_WEIGHT)
            return np.column_stack([answer @ rows.T, answer @ gradient])

        return run

    def motion_system(self) -> Run:
        p, weights = self.problem, self.problem.weights(1)
        identity = reference.motion_matrix(p.camera, p.height, p.width, 2)
        flow, pose = displacement_of(p)[:2], (p.motions[0, :, :3], p.motions[0, :, 3])

        def run() -> np.ndarray:
            tensor = reference.robust_tensor(p.terms, identity, flow, problems.DATA_SCALES)
            squared_residuals = sum(reference.residual(term, identity, flow) for term in p.terms)
            east, south = np.pad(weights, ((0, 0), (1, 0), (1, 0)))
            neighbour_weights = east[1:, 1:] + east[1:, :-1] + south[1:, 1:] + south[:-1, 1:]
            weighted_tensor = (p.labels == 0) / (
                1 + squared_residuals / problems.TOLERATED_SQUARE
            ) ** 2
            return np.column_stack(
                reference.motion_system(
                    tensor * weighted_tensor,
                    p.inverse_depth[0],
                    DEPTH_WEIGHT * neighbour_weights,
                    p.camera,
                    *pose,
                )
            )

        return run

    def matching_cost(self) -> Run:
        p = self.problem
        pose = p.motions[0, :, :3], p.motions[0, :, 3]

        def run() -> np.ndarray:
            cost = reference.matching_cost(*p.features, problems.HYPOTHESES, p.camera, *pose)
            guess_difference = np.abs(problems.HYPOTHESES - p.guess[..., None])
            cost += p.trust[..., None] * np.minimum(1, guess_difference / problems.GUESS_TRUNCATION)
            return np.moveaxis(cost * p.certain, -1, 0)

        return run

    def census_cost(self) -> Run:
        p = self.problem
        pose = p.motions[0, :, :3], p.motions[0, :, 3]

        def run() -> np.ndarray:
            cost = reference.census_cost(*p.census, problems.HYPOTHESES, p.camera, *pose)
            return np.moveaxis(cost * p.rounds_clearly, -1, 0)

        return run

    def census_transform(self) -> Run:
        frame = self.problem.frames[0].astype(np.float32)
        return lambda: reference.census_transform(frame)[None]

    def outline_cost(self) -> Run:
        p = self.problem
        key, others = p.outline_codes[0], p.outline_codes[1:]
        motions = np.repeat(p.motions[:1], len(others), axis=0)
        is_free = p.guess > np.median(p.guess)

        def run() -> np.ndarray:
            cost = reference.outline_cost(
                key, others, problems.HYPOTHESES, p.camera, motions, p.guess, is_free,
                **problems.OUTLINE_COSTS,
            )  # fmt: skip
            return np.moveaxis(cost * p.rounds_clearly, -1, 0)

        return run

    def aggregate(self) -> Run:
        cost, guide = self.problem.cost, self.problem.features[0, 0]
        return lambda: np.moveaxis(reference.aggregate(cost, guide, **problems.AGGREGATION), -1, 0)

    def best_hypothesis(self) -> Run:
        cost = self.problem.cost

        def run() -> np.ndarray:
            best = cost.argmin(2)[..., None]
            inner = (best > 0) & (best < cost.shape[2] - 1)
            neighbour_weights = [np.clip(best + side, 0, cost.shape[2] - 1) for side in (-1, 0, 1)]
            below, center, above = (
                np.take_along_axis(cost, index, 2) for index in neighbour_weights
            )
            vertex = (below - above) / np.maximum(below + above - 2 * center, MIN_CURVATURE) / 2
            return np.moveaxis(best + inner * np.clip(vertex, -0.5, 0.5), 2, 0)

        return run

    def rigid_fields(self) -> Run:
        p = self.problem
        twists = p.twists[p.labels.astype(int)]

        def run() -> np.ndarray:
            flow = displacement_of(p)[:2]
            rho = np.moveaxis(twists, 2, 0).copy()
            rho[:3] *= p.inverse_depth
            rho[:2] += flow - reference.flow(p.motion, rho)
            return np.concatenate([flow, rho])

        return run


def shared_sums(p: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return aᵀJB of two frames, (12, H, W), and the sums of aᵀJa and aᵀe, (2, H, W)."""
    parts = [
        reference.frame_equations(
            p.tensor * p.trust, p.inverse_depth[0], p.camera, motion[:, :3], motion[:, 3]
        )[2:]
        for motion in (p.motions[0], p.motions[-1])
    ]
    slopes, sums = zip(*parts, strict=True)
    return np.concatenate(slopes), np.sum(sums, axis=0)


def restricted_sums(problem: Problem) -> np.ndarray:
    """Return the tensor restricted to epipolar lines, A, B and C, (3, H, W)."""
    flow, direction = np.split(displacement_of(problem), 2)
    restricted = reference.restrict_to_line(
        [problem.tensor], flow, direction, problem.inverse_depth[0]
    )[0]
    return in_single_precision(restricted[[0, 3, 5]])


def squared_residuals(problem: Problem) -> np.ndarray:
    """Return the squared residuals under the first motion, (H, W)."""
    p = problem
    identity = reference.motion_matrix(p.camera, p.height, p.width, 2)
    pose = p.motions[0, :, :3], p.motions[0, :, 3]
    flow = reference.displacement(p.inverse_depth[0], p.camera, *pose)
    result: np.ndarray = np.maximum(reference.residual(p.tensor, identity, flow), 0)
    return result


def tolerated_square(problem: Problem) -> float:
    """Return the squared residual at which the weight in the adjustment is a quarter."""
    return DEPTH.outlier_scale**2 * float(np.median(squared_residuals(problem)))


def displacement_of(problem: Problem) -> np.ndarray:
    """Return the flow under the motion of every pixel, and its derivative in D, (4, H, W)."""
    focal = problem.camera.focal
    ray = np.concatenate([-problem.motion[:, 2], np.ones((1, problem.height, problem.width))])
    poses = problem.motions[problem.labels.astype(int)].transpose(2, 3, 0, 1)
    translation = poses[:, 3]
    points = np.einsum("ijyx,jyx->iyx", poses[:, :3], ray)
    points += translation * problem.inverse_depth / focal
    target = points[:2] / points[2]
    direction = (translation[:2] - target * translation[2]) / points[2]
    return np.concatenate([focal * (target - ray[:2]), direction])
