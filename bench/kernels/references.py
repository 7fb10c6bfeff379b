"""The steps from two frames to a motion field, by `bench.reference` or in plain NumPy."""

import numpy as np

from bench import reference
from bench.kernels.sides import NumpySide, Run
from bench.shared import problems
from bench.shared.problems import Problem
from tisfm.kernels.solve.weight_update import LINE_ENTRIES


class FieldReferences(NumpySide):
    def image_to_lanes(self) -> Run:
        image = self.problem.frames[0]
        return lambda: np.pad(image, 4, mode="edge")[None]  # a padded copy: NumPy has no lanes

    def lanes_to_images(self) -> Run:
        return lambda: self.rho.copy()  # a copy, since NumPy has no lanes

    def derivatives(self) -> Run:
        return lambda: np.array(reference.derivatives(*self.problem.frames, self.scheme))

    def flow(self) -> Run:
        return lambda: reference.flow(self.motion, self.rho)

    def warp(self) -> Run:
        image, flow = self.problem.frames[1], self.problem.flow
        return lambda: np.array(reference.warp(image, flow))

    def constancy_constraints(self) -> Run:
        p = self.problem
        arguments = (tuple(p.gradients), p.flow, p.mask)
        identity = reference.motion_matrix(p.camera, p.height, p.width, 2)

        def run() -> np.ndarray:
            terms = reference.constancy_constraints(*arguments, **problems.CONSTRAINTS)
            tensors = reference.tensors_of(terms)
            tensor = reference.robust_tensor(tensors, identity, p.flow, problems.DATA_SCALES)
            return np.concatenate(
                [*(term.reshape(-1, p.height, p.width) for term in terms), tensor]
            )

        return run

    def image_edges(self) -> Run:
        image = self.problem.frames[:1]
        is_inside = np.ones((2, *image[0].shape))
        is_inside[0, :, -1] = is_inside[1, -1] = 0

        def run() -> np.ndarray:
            steps = np.abs(np.concatenate(reference.differences(np.array(image))))
            edges = is_inside / (1 + problems.EDGE_RATE * steps)
            return edges * (is_inside.sum() / edges.sum())

        return run

    def backward_flow(self) -> Run:
        flow, flow_sum = flow_and_flow_sum(self.problem.flow)
        return lambda: flow_sum - flow

    def join(self) -> Run:
        p = self.problem
        previous, trust, masks = previous_constraints(p)
        out = p.constraints.copy()

        def run() -> np.ndarray:
            next_weight, previous_weight = trust * masks
            out[:] = (next_weight * out + previous_weight * previous) / np.maximum(
                1, next_weight + previous_weight
            )
            tensor = np.zeros((6, *out.shape[1:]))
            for constraints, scale in (
                (out[:3], problems.DATA_SCALES[0]),
                (out[3:], problems.DATA_SCALES[1]),
            ):
                slope_x, slope_y, constant = (constraints[k::3] for k in range(3))
                squared = ((slope_x * p.flow[0] + slope_y * p.flow[1] + constant) ** 2).sum(axis=0)
                root = np.sqrt(1 + squared / scale)
                pairs = ((slope_x, slope_x), (slope_x, slope_y), (slope_y, slope_y))
                pairs += ((slope_x, constant), (slope_y, constant), (constant, constant))
                tensor += np.array([(one * two).sum(axis=0) for one, two in pairs]) / root
                tensor[5] += scale * (1 / root + root - 2)
            return np.concatenate([out, tensor])

        return run

    def multiply(self) -> Run:
        factor, out = self.problem.signs, self.problem.constraints.copy()
        return lambda: np.multiply(factor, out, out=out)

    def sweep(self) -> Run:
        arguments = (self.problem.tensor, self.motion, self.weights())
        rho = self.rho.copy()

        def run() -> np.ndarray:
            reference.sweep_red_black(
                *arguments, rho, alpha=problems.ALPHA, relaxation=problems.RELAXATION
            )
            return rho

        return run

    sweep_unfused = sweep

    def update(self) -> Run:
        joint = self.scheme == "joint"
        smoothness, terms = problems.SMOOTHNESS[joint], self.problem.terms
        system_state = self.weights(), self.problem.tensor
        previous = self.problem.previous[: self.n].copy()

        def run() -> np.ndarray:
            nonlocal system_state
            weights, tensor = system_state
            state = (self.motion, self.rho)
            reference.robust_energy(terms, *state, problems.DATA_SCALES)
            reference.smoothness_energy(self.rho, smoothness)
            reference.half_quadratic_energy(tensor, *state, weights, problems.ALPHA, smoothness)
            np.linalg.norm(self.rho - previous), np.linalg.norm(self.rho)
            previous[...] = self.rho
            tensor = reference.robust_tensor(terms, *state, problems.DATA_SCALES)
            weights = reference.edge_weights(self.rho, smoothness)
            system_state = weights, tensor
            shared = weights.reshape(2, self.n, *weights.shape[1:])[:, : 1 if joint else self.n]
            entries = list(LINE_ENTRIES) if self.scheme == "line" else slice(None)
            return np.concatenate([tensor[entries], *shared])

        return run

    def prolong(self) -> Run:
        p = self.problem
        coarse, shape = p.coarse[: self.n], (p.height, p.width)
        return lambda: reference.prolong(coarse, shape, problems.DENSITY_RATIO)

    def data_precision(self) -> Run:
        n, motion = self.n, self.motion
        tensor, weights = self.problem.tensor, self.problem.weights(n)

        def run() -> np.ndarray:
            u, v = reference.flow(motion, self.rho)
            j11, j12, j22, j1, j2, jtt = tensor
            residual = j11 * u * u + 2 * j12 * u * v + j22 * v * v + 2 * (j1 * u + j2 * v) + jtt
            total = weights[:n] + weights[n:]
            total[:, :, 1:] += weights[:n, :, :-1]
            total[:, 1:] += weights[n:, :-1]
            covariance = np.einsum(
                "ckyx,kyx,dkyx->cdyx", motion, 1 / (problems.ALPHA * total), motion
            )
            m11, m12, m22 = covariance[0, 0], covariance[0, 1], covariance[1, 1]
            return np.array([j11, j12, j22, residual, m11, m12, m22])

        return run

    def share_of_data(self) -> Run:
        precision = self.problem.precision

        def run() -> np.ndarray:
            j11, j12, j22, residual, m11, m12, m22 = precision
            trace = j11 * m11 + 2 * j12 * m12 + j22 * m22
            product = np.maximum(j11 * j22 - j12**2, 0) * np.maximum(m11 * m22 - m12**2, 0)
            share = 1 - (1 + 0.5 * trace) / (1 + trace + product)  # ½ tr[J M (I + J M)⁻¹]
            return (share / (1 + residual / problems.TOLERATED_SQUARE))[None]

        return run

    def motion_fields(self) -> Run:
        focal = self.problem.camera.focal

        def run() -> np.ndarray:
            inverse_depth = np.linalg.norm(self.rho[:3], axis=0) / focal
            return np.stack([*reference.flow(self.motion, self.rho), inverse_depth])

        return run

    def splat(self) -> Run:
        # bench.reference.splat is a plain loop.
        return lambda: _splat(self.problem.flow, self.problem.residual)

    def hidden_pixels(self) -> Run:
        flow, residual = self.problem.flow, self.problem.residual
        splat_sums = _splat(flow, residual)

        def run() -> np.ndarray:
            is_inside, corners = _arrivals(flow)
            sums = sum(w * splat_sums[:, row, column] for row, column, w in corners)
            total, residual_sum, u, v = np.split(sums, [1, 2, 3])
            difference = np.hypot(u - flow[0, is_inside] * total, v - flow[1, is_inside] * total)
            is_hidden = total > problems.UNIQUENESS["density"]
            is_hidden &= difference > problems.UNIQUENESS["flow_difference"] * total
            is_hidden &= residual[is_inside] * total > residual_sum
            out = np.zeros(residual.shape, bool)
            out[is_inside] = is_hidden[0]
            return mask_moments(out)

        return run


def flow_and_flow_sum(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a flow, and the sum of the flows to the next and to the previous frame."""
    return flow, 0.1 * flow[::-1]


def previous_constraints(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return constraints of another frame, trust in both frames, and masks of both."""
    trust = np.stack([0.7 * problem.mask, 1 - 0.4 * problem.mask])
    masks = np.stack([problem.mask, problem.mask[::-1]])
    return np.ascontiguousarray(problem.constraints[:, ::-1]), trust, masks


def mask_moments(mask: np.ndarray) -> np.ndarray:
    """Return the number of pixels of a mask, and the sums of their rows and columns, (3, 1).

    A few pixels for which rounding decides change these values little.
    """
    rows, columns = np.nonzero(mask)
    return np.array([[len(rows)], [rows.sum()], [columns.sum()]], np.float64)


def _arrivals(
    flow: np.ndarray,
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Return the pixels that stay inside, and rows, columns and weights around their targets."""
    height, width = flow.shape[1:]
    x, y = flow[0] + np.arange(width), flow[1] + np.arange(height)[:, None]
    is_inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = x[is_inside], y[is_inside]
    left, top = x.astype(int), y.astype(int)
    across, down = x - left, y - top
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    return is_inside, [
        (top, left, (1 - down) * (1 - across)),
        (top, right, (1 - down) * across),
        (below, left, down * (1 - across)),
        (below, right, down * across),
    ]


def _splat(flow: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return Σw, Σw·residual, Σw·u, Σw·v, (4, H, W), at every pixel of frame 1."""
    is_inside, corners = _arrivals(flow)
    values = np.stack([np.ones_like(residual), residual, *flow])[:, is_inside]
    targets = np.concatenate([row * residual.shape[1] + column for row, column, _ in corners])
    weights = np.concatenate([values * weight for *_, weight in corners], axis=1)
    sums = [np.bincount(targets, weight, minlength=residual.size) for weight in weights]
    return np.stack(sums).reshape(4, *residual.shape)
