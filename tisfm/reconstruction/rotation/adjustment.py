"""Adjustment of all orientations, and of the focal length, to the points of all pairs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from tisfm.reconstruction.rotation.frame_pairs import FramePair
from tisfm.reconstruction.rotation.settings import ROTATION

_BLOCK = 20_000  # points whose derivatives are in memory at once


@dataclass(frozen=True, kw_only=True)
class Orientations:
    """Orientations of frames, and the focal length."""

    rotations: np.ndarray  # (F, 3, 3): camera to world
    focal: float  # px


def adjust_orientations(
    start: Orientations,
    pairs: Sequence[FramePair],  # at least one; frames are indices of `start.rotations`
    noise: float,  # px: larger residuals have a decreasing weight
    *,
    with_focal: bool,  # whether the focal length is adjusted
) -> Orientations:
    """Return the orientations with the smallest robust cost of all points.

    A point at x in the first frame is at π(K R₁ᵀ R₀ K⁻¹ x) in the second one. The cost is the sum
    of log(1 + (residual/noise)²). The first orientation stays fixed.

    References
    ----------
    Hartley, "Self-calibration of stationary cameras", IJCV 1997, doi 10.1023/A:1007957826135.
    """
    points = _Points(pairs)
    now, cost = start, points.measure_cost(start, noise)
    damping = ROTATION.start_damping
    is_free = np.ones(3 * len(start.rotations) + 1, bool)
    is_free[:3], is_free[-1] = False, with_focal
    for _ in range(ROTATION.max_steps):
        matrix, vector = points.make_normal_equations(now, noise)
        matrix, vector = matrix[is_free][:, is_free], vector[is_free]
        diagonal = diags(np.maximum(matrix.diagonal(), ROTATION.min_diagonal))
        while True:
            step = np.zeros(len(is_free))
            step[is_free] = -np.atleast_1d(spsolve((matrix + damping * diagonal).tocsc(), vector))
            step[-1] = np.clip(step[-1], -ROTATION.max_focal_step, ROTATION.max_focal_step)
            turns = Rotation.from_rotvec(step[:-1].reshape(-1, 3)).as_matrix()
            trial = Orientations(
                rotations=now.rotations @ turns, focal=float(now.focal * np.exp(step[-1]))
            )
            trial_cost = points.measure_cost(trial, noise)
            if trial_cost <= cost:
                break
            damping *= ROTATION.damping_factor
            if damping > ROTATION.max_damping:
                return now
        is_done = cost - trial_cost <= ROTATION.min_decrease * cost
        now, cost = trial, trial_cost
        damping = max(damping / ROTATION.damping_factor, ROTATION.min_damping)
        if is_done:
            break
    return now


def measure_residuals(pairs: Sequence[FramePair], found: Orientations) -> list[np.ndarray]:
    """Return the residuals of the points of each pair, (N,) px."""
    points = _Points(pairs)
    residuals = np.concatenate(
        [np.hypot(*points.project(found, part)[0].T) for part in points.split()] or [np.zeros(0)]
    )
    return np.split(residuals, points.begins[1:])


class _Points:
    """The points of all pairs, in arrays."""

    def __init__(self, pairs: Sequence[FramePair]) -> None:
        counts = np.array([len(pair.before) for pair in pairs], np.int64)
        self.begins = np.r_[0, np.cumsum(counts)[:-1]] if len(pairs) else np.zeros(0, np.int64)
        self._first = np.array([pair.first for pair in pairs], np.int64)
        self._second = np.array([pair.second for pair in pairs], np.int64)
        self._pair = np.repeat(np.arange(len(pairs)), counts)
        empty = [np.zeros((0, 2))]
        self._before = np.concatenate([pair.before for pair in pairs] or empty)
        self._after = np.concatenate([pair.after for pair in pairs] or empty)

    def split(self) -> Iterator[slice]:
        """Yield slices of points that lie in memory together."""
        for begin in range(0, len(self._pair), _BLOCK):
            yield slice(begin, begin + _BLOCK)

    def project(
        self, found: Orientations, part: slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return residuals, px; rays in the first and the second frame; and the turns."""
        pair, focal = self._pair[part], found.focal
        turns = np.swapaxes(found.rotations[self._second], 1, 2) @ found.rotations[self._first]
        rays = np.column_stack([self._before[part] / focal, np.ones(len(pair))])
        turned = np.einsum("nij,nj->ni", turns[pair], rays)
        depth = np.maximum(turned[:, 2:], ROTATION.min_ray_z)
        return focal * turned[:, :2] / depth - self._after[part], rays, turned, turns[pair]

    def measure_cost(self, found: Orientations, noise: float) -> float:
        """Return the robust cost."""
        return sum(
            float(np.log1p((self.project(found, part)[0] ** 2).sum(axis=1) / noise**2).sum())
            for part in self.split()
        )

    def make_normal_equations(
        self, found: Orientations, noise: float
    ) -> tuple[coo_matrix, np.ndarray]:
        """Return matrix and vector of the unknowns: three angles a frame, and log f."""
        count = 3 * len(found.rotations) + 1
        vector, rows, columns, values = np.zeros(count), [], [], []
        for part in self.split():
            residual, jacobian = self._differentiate(found, part)
            weights = 1 / (1 + (residual**2).sum(axis=1) / noise**2)
            weighted = jacobian * weights[:, None, None]
            pair, begins = np.unique(self._pair[part], return_index=True)
            blocks = np.add.reduceat(np.einsum("nki,nkj->nij", weighted, jacobian), begins)
            sums = np.add.reduceat(np.einsum("nki,nk->ni", weighted, residual), begins)
            axes = np.arange(3)
            unknowns = np.column_stack(
                [
                    3 * self._first[pair][:, None] + axes,
                    3 * self._second[pair][:, None] + axes,
                    np.full(len(pair), count - 1),
                ]
            )
            np.add.at(vector, unknowns, sums)
            rows.append(np.repeat(unknowns, 7, axis=1).ravel())
            columns.append(np.tile(unknowns, (1, 7)).ravel())
            values.append(blocks.ravel())
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return coo_matrix(entries, shape=(count, count)).tocsr(), vector

    def _differentiate(self, found: Orientations, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals, (N, 2), and their derivatives, (N, 2, 7).

        R₀ → R₀ exp(a) turns a ray x in the first frame into x + a × x. R₁ → R₁ exp(b) turns a ray v
        in the second frame into v − b × v.
        """
        residual, rays, turned, turns = self.project(found, part)
        focal, depth = found.focal, np.maximum(turned[:, 2], ROTATION.min_ray_z)
        u, v, zero = turned[:, 0] / depth, turned[:, 1] / depth, np.zeros_like(depth)
        projection = (focal / depth)[:, None, None] * np.stack(
            [np.column_stack([zero + 1, zero, -u]), np.column_stack([zero, zero + 1, -v])], axis=1
        )
        ray_change = np.column_stack([-rays[:, :2], zero])  # by log f
        focal_change = np.einsum(
            "nij,nj->ni", projection, np.einsum("nij,nj->ni", turns, ray_change)
        ) + focal * np.column_stack([u, v])
        return residual, np.concatenate(
            [
                projection @ turns @ _make_cross_matrices(rays),
                -projection @ _make_cross_matrices(turned),
                focal_change[:, :, None],
            ],
            axis=2,
        )


def _make_cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices, (N, 3, 3), that map a to a × v for vectors v, (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack(
        [
            np.column_stack([zero, z, -y]),
            np.column_stack([-z, zero, x]),
            np.column_stack([y, -x, zero]),
        ],
        axis=1,
    )
