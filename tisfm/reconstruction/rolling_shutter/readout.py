"""Estimate of the readout time of a rolling shutter, from tracks and matches of views.

Poses of views, points, the readout and the focal length are adjusted together. Where the camera's
motion changes, poses cannot explain the effect of a readout. Where the motion is uniform, poses and
the focal length may explain the same effect, and the deviation of the readout is large.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tisfm.camera import Camera
from tisfm.reconstruction.geometry.rays import nearest_point_equations, unit_vectors
from tisfm.reconstruction.tracks.views import View
from tisfm.shutter import moved_by_twist

# Values without a stated source were set by hand.

# The smallest number of views that show a point.
MIN_VIEWS = 3
# The largest number of views in use: consecutive ones, in which the camera rotates most.
MAX_VIEWS = 60
# Observations in use: points that most views show are taken first, until this number.
MAX_OBSERVATIONS = 8000
# px: larger residuals have a decreasing weight; the first value is for the first steps.
OUTLIER_PIXELS = (3.0, 1.0)
# Gauss–Newton steps with each of these values.
STEPS_PER_SCALE = 4
# Damping of the steps, as a share of the diagonal.
DAMPING = 1e-4
# Damping of the system that gives the standard deviation, as a share of the diagonal. Larger
# damping would act as a prior, and hide that the focal length or poses explain the same effect.
MIN_DAMPING = 1e-10
# Depth, in the unit of the poses: nearer points are not visible.
MIN_DEPTH = 1e-6
# The standard deviation is this multiple of its value for independent residuals: errors of films
# with a global shutter are this much larger.
DEPENDENCE = 5.5
# px: observations with a larger residual are ignored.
MAX_RESIDUAL = 100.0


@dataclass(frozen=True, kw_only=True)
class ReadoutEstimate:
    """A readout time and its standard deviation, both in intervals between frames."""

    readout: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """Observations: numbers of the view and of the point, (N,), and positions, (N, 2) px."""

    view: np.ndarray
    point: np.ndarray
    place: np.ndarray

    def of(self, kept: np.ndarray) -> "_Seen":
        """Return a subset, with points renumbered."""
        _, point = np.unique(self.point[kept], return_inverse=True)
        return _Seen(view=self.view[kept], point=point, place=self.place[kept])


def estimate_readout(
    # views with points as the frames show them, not corrected for the readout
    views: Sequence[View],
    # mapping of (int, int) to (N, 2) int array: for pairs of indices of views: indices of their
    # detected points that match
    matches: Mapping[tuple[int, int], np.ndarray],
    # mapping of int to (4, 4) array: current poses, camera to world, by frame
    poses: Mapping[int, np.ndarray],
    # mapping of int to (6,) array: motion per interval, by frame, as `tisfm.shutter.rates_of`
    # returns it
    rates: Mapping[int, np.ndarray],
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],  # height and width of the frames, px
    *,
    begun: float = 0.0,  # readout that the estimation starts from
) -> ReadoutEstimate | None:  # none if views share too few points
    """Estimate the readout of a camera."""
    numbers = [k for k, view in enumerate(views) if view.frame in rates]
    if len(numbers) < MIN_VIEWS:
        return None
    numbers = _turning(numbers, views, rates)
    seen = _seen_by(views, matches, numbers)
    if not len(seen.view):
        return None
    frames = [views[k].frame for k in numbers]
    problem = _Problem(
        seen,
        np.linalg.inv(np.array([poses[frame] for frame in frames])),
        np.array([rates[frame] for frame in frames]),
        camera,
        shape,
        begun,
    )
    for outlying in OUTLIER_PIXELS:
        for _ in range(STEPS_PER_SCALE):
            problem.step(outlying)
    deviation = problem.deviation(OUTLIER_PIXELS[-1])
    return ReadoutEstimate(readout=problem.readout, deviation=DEPENDENCE * deviation)


def _turning(
    numbers: list[int], views: Sequence[View], rates: Mapping[int, np.ndarray]
) -> list[int]:
    """Return at most MAX_VIEWS consecutive views: those in which the camera rotates most."""
    if len(numbers) <= MAX_VIEWS:
        return numbers
    turns = np.cumsum([0.0, *(np.linalg.norm(rates[views[k].frame][3:]) for k in numbers)])
    first = int(np.argmax(turns[MAX_VIEWS:] - turns[:-MAX_VIEWS]))
    return numbers[first : first + MAX_VIEWS]


def _seen_by(
    views: Sequence[View], matches: Mapping[tuple[int, int], np.ndarray], numbers: Sequence[int]
) -> _Seen:
    """Return the observations of the tracks and matched points that most views see."""
    order = {number: k for k, number in enumerate(numbers)}
    begins = np.cumsum([0, *(len(views[number].detected) for number in numbers)])
    pairs = [
        both + np.array([begins[order[first]], begins[order[second]]])
        for (first, second), both in matches.items()
        if first in order and second in order
    ]
    ends = np.vstack([np.empty((0, 2), np.intp), *pairs])
    count = int(begins[-1])
    graph = sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (count, count))
    _, group = sparse.csgraph.connected_components(graph, directed=False)
    of_detected = np.repeat(np.arange(len(numbers)), np.diff(begins))
    tracks = [views[number].observations.tracks for number in numbers]
    view = np.r_[np.repeat(np.arange(len(numbers)), list(map(len, tracks))), of_detected]
    point = np.r_[np.concatenate(tracks), -1 - group]
    place = np.vstack(
        [*(views[k].observations.points for k in numbers), *(views[k].detected for k in numbers)]
    )
    if not len(view):
        return _Seen(view=view, point=point, place=place)
    whole = _Seen(view=view, point=np.unique(point, return_inverse=True)[1], place=place)
    # A point that one view shows twice is a wrong match.
    twice = np.unique(whole.point * len(numbers) + whole.view, return_counts=True)
    wrong = np.unique(twice[0][twice[1] > 1] // len(numbers))
    often = np.bincount(whole.point)
    often[wrong] = 0
    ranked = np.sort(often)[::-1]
    enough = ranked[np.searchsorted(np.cumsum(ranked), MAX_OBSERVATIONS).clip(0, len(ranked) - 1)]
    return whole.of(often[whole.point] >= max(MIN_VIEWS, enough))


class _Problem:
    """Joint adjustment of poses, points, readout time and focal length."""

    def __init__(
        self,
        seen: _Seen,
        poses: np.ndarray,  # (V, 4, 4) array: world to camera
        rates: np.ndarray,  # (V, 6) array
        # camera, shape, readout: as for `estimate_readout`
        camera: Camera,
        shape: tuple[int, int],
        readout: float,
    ) -> None:
        self.readout = readout
        self._seen, self._rates = seen, rates
        self._turns, self._shifts = poses[:, :3, :3].copy(), poses[:, :3, 3].copy()
        self._focal = camera.focal
        self._places = seen.place - camera.center_for(*shape)
        self._late = (seen.place[:, 1] - (shape[0] - 1) / 2) / shape[0]
        self._points = self._nearest_to_rays()

    def step(self, outlying: float) -> None:
        """Make one Gauss–Newton step."""
        step, moves, _ = self._solved(*self._linearised(outlying), DAMPING)
        self._move(step[:-2].reshape(-1, 6), moves)
        self.readout += float(step[-2])
        self._focal *= float(np.exp(step[-1]))

    def deviation(self, outlying: float) -> float:
        """Return the standard deviation of the readout time for independent residuals."""
        return self._solved(*self._linearised(outlying), MIN_DAMPING)[2]

    def _linearised(self, outlying: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return weighted derivatives by poses, points, and readout and log focal; and residuals.

        The residuals are weighted too.
        """
        view = self._seen.view
        local = self._in_views()
        late = self.readout * self._late
        speed = self._rates[view, :3] + np.cross(self._rates[view, 3:], local)
        moved = local + late[:, None] * speed
        z = np.maximum(moved[:, 2], MIN_DEPTH)
        seen = self._focal * moved[:, :2] / z[:, None]
        off = seen - self._places
        square = (off**2).sum(axis=1)
        counts = (moved[:, 2] > MIN_DEPTH) & (square < MAX_RESIDUAL**2)
        weight = np.where(counts, 1 / (1 + square / outlying**2), 0)
        root = np.sqrt(weight)[:, None, None]
        slope = np.zeros((len(z), 2, 3))
        slope[:, 0, 0] = slope[:, 1, 1] = self._focal / z
        slope[:, :, 2] = -self._focal * moved[:, :2] / z[:, None] ** 2
        by_point = slope @ self._turns[view] * root
        turned = np.stack([np.cross(axis, local) for axis in np.eye(3)], axis=2)
        by_view = np.concatenate([slope, slope @ turned], axis=2) * root
        by_readout = slope @ (self._late[:, None] * speed)[:, :, None]
        by_camera = np.concatenate([by_readout, seen[:, :, None]], axis=2) * root
        return by_view, by_point, by_camera, off * root[:, :, 0]

    def _solved(
        self,
        by_view: np.ndarray,
        by_point: np.ndarray,
        by_camera: np.ndarray,
        off: np.ndarray,
        damping: float,
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the step of poses, readout and log focal, the step of points, and the deviation.

        The deviation is the standard deviation of the readout. Points are eliminated (Schur
        complement).
        """
        view, point = self._seen.view, self._seen.point
        views, points = len(self._turns), len(self._points)
        left = sparse.hstack(
            [_blocks(by_view, view, views), sparse.csr_matrix(by_camera.reshape(-1, 2))]
        ).tocsr()
        right = _blocks(by_point, point, points)
        own = np.zeros((points, 3, 3))
        np.add.at(own, point, np.swapaxes(by_point, 1, 2) @ by_point)
        trace = np.trace(own, axis1=1, axis2=2)[:, None, None]
        own += (damping * trace + 1e-12) * np.eye(3)
        inverse = sparse.bsr_matrix(
            (np.linalg.inv(own), np.arange(points), np.arange(points + 1)),
            shape=(3 * points, 3 * points),
        )
        shared = (left.T @ right).tocsr()
        pull = right.T @ off.ravel()
        matrix = (left.T @ left).toarray() - (shared @ inverse @ shared.T).toarray()
        vector = left.T @ off.ravel() - shared @ (inverse @ pull)
        diagonal = np.diag(matrix).copy()
        matrix += np.diag(damping * diagonal + 1e-12 * max(float(diagonal.max()), 1e-12))
        matrix += self._gauge(diagonal)
        readout = np.zeros(len(vector))
        readout[-2] = 1
        answers = np.linalg.solve(matrix, np.stack([-vector, readout], axis=1))
        step = answers[:, 0]
        moves = -(inverse @ (pull + shared.T @ step)).reshape(-1, 3)
        free = max(1, off.size - len(vector) - 3 * points)
        deviation = np.sqrt(float((off**2).sum()) / free * max(float(answers[-2, 1]), 0.0))
        return step, moves, float(deviation)

    def _gauge(self, diagonal: np.ndarray) -> np.ndarray:
        """Return the gauge term, which fixes the first view and its distance to the farthest view.

        A common motion, rotation and scaling of poses and points does not change the images. The
        rates have a fixed unit: without this term, any readout time would fit a camera that does
        not rotate.
        """
        held = np.zeros((7, len(diagonal)))
        held[np.arange(6), np.arange(6)] = np.sqrt(diagonal[:6].max())
        centers = -np.einsum("nji,nj->ni", self._turns, self._shifts)
        away = np.einsum("nij,nj->ni", self._turns, centers - centers[0])
        distances = np.linalg.norm(away, axis=1)
        farthest = int(np.argmax(distances))
        if distances[farthest] > 0:
            columns = slice(6 * farthest, 6 * farthest + 3)
            direction = away[farthest] / distances[farthest]
            held[6, columns] = np.sqrt(diagonal[columns].max()) * direction
        return np.asarray(held.T @ held)

    def _move(self, steps: np.ndarray, moves: np.ndarray) -> None:
        for k, step in enumerate(steps):
            columns = np.vstack([self._turns[k].T, self._shifts[k]])
            moved = moved_by_twist(columns, np.r_[np.zeros(3), step[3:]], np.ones(4))
            self._turns[k], self._shifts[k] = moved[:3].T, moved[3] + step[:3]
        self._points += moves

    def _in_views(self) -> np.ndarray:
        view = self._seen.view
        world = self._points[self._seen.point]
        return np.asarray(np.einsum("nij,nj->ni", self._turns[view], world) + self._shifts[view])

    def _nearest_to_rays(self) -> np.ndarray:
        """Return the points nearest to the rays of their observations, (P, 3)."""
        view, point = self._seen.view, self._seen.point
        local = np.column_stack([self._places / self._focal, np.ones(len(view))])
        if self.readout:  # rays of the middle row, without the camera's translation
            spin = self._rates[view, 3:] * (-self.readout * self._late)[:, None]
            local = local + np.cross(spin, local)
        ray = np.einsum("nji,nj->ni", self._turns[view], local)
        ray = unit_vectors(ray)
        centre = -np.einsum("nji,nj->ni", self._turns, self._shifts)[view]
        matrix, vector = nearest_point_equations(point, ray, centre, int(point.max()) + 1)
        matrix += 1e-9 * np.eye(3)
        return np.asarray(np.linalg.solve(matrix, vector[..., None])[..., 0])


def _blocks(values: np.ndarray, number: np.ndarray, count: int) -> sparse.csr_matrix:
    """Return the (2 N, k·count) sparse matrix of blocks, (N, 2, k), in columns of their numbers."""
    rows, _, wide = values.shape
    columns = (wide * number)[:, None, None] + np.broadcast_to(np.arange(wide), values.shape)
    begins = np.arange(0, 2 * rows * wide + 1, wide)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), begins), (2 * rows, wide * count))
