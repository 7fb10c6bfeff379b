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
from tisfm.reconstruction.rolling_shutter.settings import ROLLING_SHUTTER
from tisfm.reconstruction.tracks.views import View
from tisfm.shutter import move_by_twist

# Damping of the system that gives the standard deviation, as a share of the diagonal. Larger
# damping would act as a prior, and hide that the focal length or poses explain the same effect. Set
# by hand.
MIN_DAMPING = 1e-10
# Depth, in the unit of the poses: nearer points are not visible. Set by hand.
MIN_DEPTH = 1e-6


@dataclass(frozen=True, kw_only=True)
class ReadoutEstimate:
    """A readout time and its standard deviation, both in intervals between frames."""

    readout: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class _ViewObservations:
    """Positions of points in views."""

    view: np.ndarray  # (N,) int: index of the view
    point: np.ndarray  # (N,) int: number of the point
    position: np.ndarray  # (N, 2) px

    def select(self, is_selected: np.ndarray) -> "_ViewObservations":
        """Return the selected observations, (N,) bool, with new numbers of points from 0."""
        _, point = np.unique(self.point[is_selected], return_inverse=True)
        return _ViewObservations(
            view=self.view[is_selected], point=point, position=self.position[is_selected]
        )


def estimate_readout(
    # views with points as the frames show them, not corrected for the readout
    views: Sequence[View],
    # by pair of view indices: (N, 2) int array, the indices of their detected points that match
    matches: Mapping[tuple[int, int], np.ndarray],
    # by frame: (4, 4) array, the current pose, camera to world
    poses: Mapping[int, np.ndarray],
    # by frame: (6,) array, motion per interval between frames, from `tisfm.shutter.motion_rates`
    rates: Mapping[int, np.ndarray],
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],  # height and width of the frames, px
    *,
    start: float = 0.0,  # start value of the readout time
) -> ReadoutEstimate | None:  # None if views share too few points
    """Estimate the readout time of a camera."""
    view_indices = [k for k, view in enumerate(views) if view.frame in rates]
    if len(view_indices) < ROLLING_SHUTTER.min_views:
        return None
    view_indices = _select_rotating_views(view_indices, views, rates)
    observations = _collect_observations(views, matches, view_indices)
    if not len(observations.view):
        return None
    frames = [views[k].frame for k in view_indices]
    adjustment = _JointAdjustment(
        observations,
        np.linalg.inv(np.array([poses[frame] for frame in frames])),
        np.array([rates[frame] for frame in frames]),
        camera,
        shape,
        start,
    )
    for outlier_scale in ROLLING_SHUTTER.outlier_scales:
        for _ in range(ROLLING_SHUTTER.steps_per_scale):
            adjustment.step(outlier_scale)
    deviation = adjustment.deviation(ROLLING_SHUTTER.outlier_scales[-1])
    return ReadoutEstimate(
        readout=adjustment.readout, deviation=ROLLING_SHUTTER.deviation_factor * deviation
    )


def _select_rotating_views(
    view_indices: list[int], views: Sequence[View], rates: Mapping[int, np.ndarray]
) -> list[int]:
    """Return consecutive views, as many as allowed, in which the camera rotates most."""
    count = ROLLING_SHUTTER.max_views
    if len(view_indices) <= count:
        return view_indices
    cumulative_rotation = np.cumsum(
        [0.0, *(np.linalg.norm(rates[views[k].frame][3:]) for k in view_indices)]
    )
    first = int(np.argmax(cumulative_rotation[count:] - cumulative_rotation[:-count]))
    return view_indices[first : first + count]


def _collect_observations(
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    view_indices: Sequence[int],
) -> _ViewObservations:
    """Return the observations of the tracks and matched points that most views see."""
    position_of_view = {number: k for k, number in enumerate(view_indices)}
    begins = np.cumsum([0, *(len(views[number].detected) for number in view_indices)])
    pairs = [
        indices + np.array([begins[position_of_view[first]], begins[position_of_view[second]]])
        for (first, second), indices in matches.items()
        if first in position_of_view and second in position_of_view
    ]
    point_pairs = np.vstack([np.empty((0, 2), np.intp), *pairs])
    count = int(begins[-1])
    graph = sparse.coo_matrix(
        (np.ones(len(point_pairs)), (point_pairs[:, 0], point_pairs[:, 1])), (count, count)
    )
    _, group = sparse.csgraph.connected_components(graph, directed=False)
    view_of_detected = np.repeat(np.arange(len(view_indices)), np.diff(begins))
    tracks = [views[number].observations.tracks for number in view_indices]
    view = np.r_[np.repeat(np.arange(len(view_indices)), list(map(len, tracks))), view_of_detected]
    point = np.r_[np.concatenate(tracks), -1 - group]
    position = np.vstack(
        [
            *(views[k].observations.points for k in view_indices),
            *(views[k].detected for k in view_indices),
        ]
    )
    if not len(view):
        return _ViewObservations(view=view, point=point, position=position)
    all_observations = _ViewObservations(
        view=view, point=np.unique(point, return_inverse=True)[1], position=position
    )
    # A point with two observations in one view comes from a wrong match.
    keys_and_counts = np.unique(
        all_observations.point * len(view_indices) + all_observations.view, return_counts=True
    )
    wrong_points = np.unique(keys_and_counts[0][keys_and_counts[1] > 1] // len(view_indices))
    counts = np.bincount(all_observations.point)
    counts[wrong_points] = 0
    sorted_counts = np.sort(counts)[::-1]
    last_index = np.searchsorted(np.cumsum(sorted_counts), ROLLING_SHUTTER.max_observations)
    min_count = sorted_counts[last_index.clip(0, len(sorted_counts) - 1)]
    return all_observations.select(
        counts[all_observations.point] >= max(ROLLING_SHUTTER.min_views, min_count)
    )


class _JointAdjustment:
    """Joint adjustment of poses, points, readout time and focal length."""

    def __init__(
        self,
        observations: _ViewObservations,
        poses: np.ndarray,  # (V, 4, 4) array: world to camera
        rates: np.ndarray,  # (V, 6) array: motion per interval between frames
        # camera, shape, readout: as for `estimate_readout`
        camera: Camera,
        shape: tuple[int, int],
        readout: float,
    ) -> None:
        self.readout = readout
        self._observations, self._rates = observations, rates
        self._rotations, self._translations = poses[:, :3, :3].copy(), poses[:, :3, 3].copy()
        self._focal = camera.focal
        self._positions = observations.position - camera.center_for(*shape)
        # Time of a row after the middle row, divided by the readout time
        self._row_delay = (observations.position[:, 1] - (shape[0] - 1) / 2) / shape[0]
        self._points = self._points_nearest_to_rays()

    def step(self, outlier_scale: float) -> None:
        """Make one Gauss–Newton step."""
        step, point_steps, _ = self._solve(*self._linearise(outlier_scale), ROLLING_SHUTTER.damping)
        self._apply_step(step[:-2].reshape(-1, 6), point_steps)
        self.readout += float(step[-2])
        self._focal *= float(np.exp(step[-1]))

    def deviation(self, outlier_scale: float) -> float:
        """Return the standard deviation of the readout time for independent residuals."""
        return self._solve(*self._linearise(outlier_scale), MIN_DAMPING)[2]

    def _linearise(
        self, outlier_scale: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return derivatives by poses, by points, and by readout and log focal; and residuals.

        Each row of the derivatives and residuals is multiplied by the root of its weight.
        """
        view = self._observations.view
        local = self._points_in_views()
        delay = self.readout * self._row_delay
        velocity = self._rates[view, :3] + np.cross(self._rates[view, 3:], local)
        moved_points = local + delay[:, None] * velocity
        z = np.maximum(moved_points[:, 2], MIN_DEPTH)
        projections = self._focal * moved_points[:, :2] / z[:, None]
        residual = projections - self._positions
        square_residual = (residual**2).sum(axis=1)
        is_used = (moved_points[:, 2] > MIN_DEPTH) & (
            square_residual < ROLLING_SHUTTER.max_residual**2
        )
        weight = np.where(is_used, 1 / (1 + square_residual / outlier_scale**2), 0)
        root_weight = np.sqrt(weight)[:, None, None]
        jacobian = np.zeros((len(z), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = self._focal / z
        jacobian[:, :, 2] = -self._focal * moved_points[:, :2] / z[:, None] ** 2
        by_point = jacobian @ self._rotations[view] * root_weight
        rotation_derivatives = np.stack([np.cross(axis, local) for axis in np.eye(3)], axis=2)
        by_view = np.concatenate([jacobian, jacobian @ rotation_derivatives], axis=2) * root_weight
        by_readout = jacobian @ (self._row_delay[:, None] * velocity)[:, :, None]
        by_camera = np.concatenate([by_readout, projections[:, :, None]], axis=2) * root_weight
        return by_view, by_point, by_camera, residual * root_weight[:, :, 0]

    def _solve(
        self,
        by_view: np.ndarray,  # (N, 2, 6)
        by_point: np.ndarray,  # (N, 2, 3)
        by_camera: np.ndarray,  # (N, 2, 2)
        residual: np.ndarray,  # (N, 2)
        damping: float,  # share of the diagonal
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the step of poses, readout and log focal, the step of points, and the deviation.

        The deviation is the standard deviation of the readout. Points are eliminated (Schur
        complement).
        """
        view, point = self._observations.view, self._observations.point
        views, points = len(self._rotations), len(self._points)
        camera_jacobian = sparse.hstack(
            [_block_matrix(by_view, view, views), sparse.csr_matrix(by_camera.reshape(-1, 2))]
        ).tocsr()
        point_jacobian = _block_matrix(by_point, point, points)
        point_blocks = np.zeros((points, 3, 3))
        np.add.at(point_blocks, point, np.swapaxes(by_point, 1, 2) @ by_point)
        trace = np.trace(point_blocks, axis1=1, axis2=2)[:, None, None]
        point_blocks += (damping * trace + 1e-12) * np.eye(3)
        inverse = sparse.bsr_matrix(
            (np.linalg.inv(point_blocks), np.arange(points), np.arange(points + 1)),
            shape=(3 * points, 3 * points),
        )
        cross_blocks = (camera_jacobian.T @ point_jacobian).tocsr()
        point_gradient = point_jacobian.T @ residual.ravel()
        matrix = (camera_jacobian.T @ camera_jacobian).toarray() - (
            cross_blocks @ inverse @ cross_blocks.T
        ).toarray()
        vector = camera_jacobian.T @ residual.ravel() - cross_blocks @ (inverse @ point_gradient)
        diagonal = np.diag(matrix).copy()
        matrix += np.diag(damping * diagonal + 1e-12 * max(float(diagonal.max()), 1e-12))
        matrix += self._gauge(diagonal)
        readout_axis = np.zeros(len(vector))
        readout_axis[-2] = 1
        solution = np.linalg.solve(matrix, np.stack([-vector, readout_axis], axis=1))
        step = solution[:, 0]
        point_steps = -(inverse @ (point_gradient + cross_blocks.T @ step)).reshape(-1, 3)
        degrees_of_freedom = max(1, residual.size - len(vector) - 3 * points)
        deviation = np.sqrt(
            float((residual**2).sum()) / degrees_of_freedom * max(float(solution[-2, 1]), 0.0)
        )
        return step, point_steps, float(deviation)

    def _gauge(self, diagonal: np.ndarray) -> np.ndarray:
        """Return the gauge term: it fixes the first view and its distance to the farthest view.

        A common motion, rotation and scaling of poses and points does not change the images. The
        rates have a fixed unit: without this term, any readout time would fit a camera that does
        not rotate.
        """
        constraints = np.zeros((7, len(diagonal)))
        constraints[np.arange(6), np.arange(6)] = np.sqrt(diagonal[:6].max())
        centers = -np.einsum("nji,nj->ni", self._rotations, self._translations)
        offsets = np.einsum("nij,nj->ni", self._rotations, centers - centers[0])
        distances = np.linalg.norm(offsets, axis=1)
        farthest = int(np.argmax(distances))
        if distances[farthest] > 0:
            columns = slice(6 * farthest, 6 * farthest + 3)
            direction = offsets[farthest] / distances[farthest]
            constraints[6, columns] = np.sqrt(diagonal[columns].max()) * direction
        return np.asarray(constraints.T @ constraints)

    def _apply_step(self, steps: np.ndarray, point_steps: np.ndarray) -> None:
        for k, step in enumerate(steps):
            columns = np.vstack([self._rotations[k].T, self._translations[k]])
            moved_columns = move_by_twist(columns, np.r_[np.zeros(3), step[3:]], np.ones(4))
            self._rotations[k], self._translations[k] = (
                moved_columns[:3].T,
                moved_columns[3] + step[:3],
            )
        self._points += point_steps

    def _points_in_views(self) -> np.ndarray:
        """Return the points of the observations, (N, 3), in the coordinates of their views."""
        view = self._observations.view
        world = self._points[self._observations.point]
        return np.asarray(
            np.einsum("nij,nj->ni", self._rotations[view], world) + self._translations[view]
        )

    def _points_nearest_to_rays(self) -> np.ndarray:
        """Return the points nearest to the rays of their observations, (P, 3)."""
        view, point = self._observations.view, self._observations.point
        local = np.column_stack([self._positions / self._focal, np.ones(len(view))])
        if self.readout:  # rays at the time of the middle row, without the camera's translation
            rotation = self._rates[view, 3:] * (-self.readout * self._row_delay)[:, None]
            local = local + np.cross(rotation, local)
        ray = np.einsum("nji,nj->ni", self._rotations[view], local)
        ray = unit_vectors(ray)
        centre = -np.einsum("nji,nj->ni", self._rotations, self._translations)[view]
        matrix, vector = nearest_point_equations(point, ray, centre, int(point.max()) + 1)
        matrix += 1e-9 * np.eye(3)
        return np.asarray(np.linalg.solve(matrix, vector[..., None])[..., 0])


def _block_matrix(values: np.ndarray, number: np.ndarray, count: int) -> sparse.csr_matrix:
    """Return the sparse matrix of blocks, (N, 2, k), with block columns `number`, (N,).

    Its shape is (2 N, k·count).
    """
    rows, _, width = values.shape
    columns = (width * number)[:, None, None] + np.broadcast_to(np.arange(width), values.shape)
    begins = np.arange(0, 2 * rows * width + 1, width)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), begins), (2 * rows, width * count))
