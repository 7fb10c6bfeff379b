"""Scores of models, and the area of frames that models explain.

The score tells how well a model explains the matches of views. It counts every match, with or
without a triangulated point. If the camera moves forward, far points often have no triangulated
position. The number of triangulated observations may then prefer a wrong path with sideways motion.

The area tells whether a model follows the static scene. A moving object may have more texture than
the static scene, and so more points.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tisfm.reconstruction.geometry.rays import unit_vectors
from tisfm.reconstruction.mapping.database import PIXEL_CENTRE
from tisfm.reconstruction.mapping.first_pairs import first_pair_tolerance
from tisfm.reconstruction.mapping.parallax import epipolar_angles
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.tracks.views import View

Pairs = Mapping[tuple[int, int], np.ndarray]
"""By pair of view indices: (N, 2) int array, the indices of matching points. Points of a view are
its tracks, followed by its detected points."""


class MatchScorer:
    """Scores models by all matches of views.

    The score of a match is 1/(1 + (d/s)²). d is the distance, px, of the point in the second view
    from the epipolar half line of the point in the first view, which begins at infinite depth. s is
    half the tolerance of first pairs (`first_pair_tolerance`).
    """

    def __init__(
        self,
        views: Sequence[View],
        pairs: Pairs,
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> None:
        self._pairs, self._scale = pairs, first_pair_tolerance(max(shape)) / 2
        self._points = [np.vstack([view.observations.points, view.detected]) for view in views]

    def match_count(
        self,
        views: Collection[int] | None = None,  # pycolmap's numbers of views, which begin with 1
    ) -> int:
        """Return the number of matches between these views; by default between all views."""
        if views is None:
            return sum(map(len, self._pairs.values()))
        selected = set(views)
        return sum(
            len(indices)
            for (first, second), indices in self._pairs.items()
            if first + 1 in selected and second + 1 in selected
        )

    def score(self, model: Any) -> float:
        """Return the sum of the scores of the matches between the views of a pycolmap model."""
        return sum(score for score, _ in self._pair_scores(model).values())

    def worst_view_share(self, model: Any) -> float:
        """Return the mean match score of the worst view, divided by the median over all views.

        The share is near 1 for a right model. It is small if one view has a wrong pose, even if the
        model explains most matches.
        """
        sums: dict[int, np.ndarray] = {}
        for pair, score in self._pair_scores(model).items():
            for view in pair:
                sums[view] = sums.get(view, np.zeros(2)) + score
        means = [score / count for score, count in sums.values() if count]
        return float(min(means) / np.median(means)) if means and max(means) > 0 else 0.0

    def _pair_scores(self, model: Any) -> dict[tuple[int, int], tuple[float, int]]:
        """Return the sum of the scores, and the number, of the matches of every pair of views."""
        scores = {}
        for pair, geometry in _pairs_of_model(model, self._points, self._pairs):
            distance = _focal(model) * half_line_distances(*geometry) / self._scale
            scores[pair] = float((1 / (1 + distance**2)).sum()), len(distance)
        return scores


def half_line_distances(
    # pose0, pose1: (3, 4) array, world to camera, of two views
    pose0: np.ndarray,
    pose1: np.ndarray,
    # before, after: (N, 3) array, directions to matching points in the first and the second view; z
    # of `after` is positive
    before: np.ndarray,
    after: np.ndarray,
) -> np.ndarray:
    """Return the distances of points from their epipolar half lines.

    A half line goes from the point at infinite depth towards the epipole, the image of the first
    camera. It ends at the epipole if the first camera is in front of the second.

    Returns (N,) float64, in focal lengths; infinite if the nearest position on the half line is not
    in front of the second camera.
    """
    rotation = pose1[:, :3] @ pose0[:, :3].T
    infinite = before @ rotation.T
    translation = pose1[:, 3] - rotation @ pose0[:, 3]
    image_points = after / after[:, 2:]
    normal = np.cross(infinite, translation)
    normal_length = np.maximum(np.hypot(normal[:, 0], normal[:, 1]), 1e-12)
    to_line = np.abs((image_points * normal).sum(axis=1)) / normal_length
    # A point beyond infinity would lie behind both cameras. A point beyond the epipole would lie
    # behind the first camera.
    beyond_infinity = (np.cross(infinite, after) * normal).sum(axis=1) < 0
    beyond_epipole = (np.cross(after, translation) * normal).sum(axis=1) < 0
    has_no_line = np.linalg.norm(normal, axis=1) < 1e-12  # the translation is 0 or along it
    to_infinity = _distance_to(infinite, image_points)
    to_epipole = _distance_to(np.broadcast_to(translation, image_points.shape), image_points)
    distances = np.where(beyond_epipole, to_epipole, to_line)
    return np.where(beyond_infinity | has_no_line, to_infinity, distances)


def _distance_to(direction: np.ndarray, image_points: np.ndarray) -> np.ndarray:
    """Return the distances of points with z = 1 from directions; infinite for z ≤ 0."""
    z = np.where(direction[:, 2] > 1e-9, direction[:, 2], np.nan)
    distances = np.hypot(*(image_points - direction / z[:, None])[:, :2].T)
    return np.nan_to_num(distances, nan=np.inf)


class Coverage:
    """Computes the share of the area of frames that models explain.

    A match of two views stands for the area nearest to its point in each view. A model explains a
    match that lies near its epipolar line. Triangulated points are not needed: a model has none
    where the scene is too far away to show parallax.
    """

    def __init__(
        self,
        views: Sequence[View],
        pairs: Pairs,
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> None:
        self._pairs, self._max_distance = pairs, MAPPING.epipolar_tolerance * max(shape) / 640
        self._points = [np.vstack([view.observations.points, view.detected]) for view in views]
        areas = self._areas(grid_points(shape))
        self._weights = {
            (first, second): areas[first][indices[:, 0]] + areas[second][indices[:, 1]]
            for (first, second), indices in pairs.items()
        }

    def explained_matches(self, models: Sequence[Any]) -> dict[tuple[int, int], np.ndarray]:
        """Return, for each pair of views, the matches that any pycolmap reconstruction explains."""
        model_of_view = {
            view - 1: k for k, model in enumerate(models) for view in model.reg_image_ids()
        }
        is_explained = {
            (first, second): np.zeros(len(indices), bool)
            for (first, second), indices in self._pairs.items()
            if model_of_view.get(first) == model_of_view.get(second)
            or not {first, second} <= set(model_of_view)
        }
        for model in models:
            for pair, geometry in _pairs_of_model(model, self._points, self._pairs):
                distance = _focal(model) * epipolar_angles(*geometry)
                is_explained[pair] |= distance < self._max_distance
        return is_explained

    def explained_area(self, explained_matches: Mapping[tuple[int, int], np.ndarray]) -> float:
        """Return the explained share of the area that all matches stand for."""
        parts = [
            (self._weights[pair][is_explained].sum(), self._weights[pair].sum())
            for pair, is_explained in explained_matches.items()
        ]
        explained_sum, total = np.sum(parts, axis=0) if parts else (0.0, 0.0)
        return float(explained_sum / total) if total else 0.0

    def _areas(self, grid: np.ndarray) -> list[np.ndarray]:
        """Return, by view, the share of grid points nearest to each matched point; 0 for others."""
        matched_masks = [np.zeros(len(points), bool) for points in self._points]
        for (first, second), indices in self._pairs.items():
            matched_masks[first][indices[:, 0]] = True
            matched_masks[second][indices[:, 1]] = True
        areas = []
        for points, is_matched in zip(self._points, matched_masks, strict=True):
            area = np.zeros(len(points))
            if is_matched.any():
                _, nearest = cKDTree(points[is_matched]).query(grid)
                area[is_matched] = np.bincount(nearest, minlength=is_matched.sum()) / len(grid)
            areas.append(area)
        return areas


def grid_points(shape: tuple[int, int]) -> np.ndarray:
    """Return (x, y) of grid points over a frame, (N, 2), px."""
    side = max(shape) / MAPPING.grid_cells
    rows, columns = (
        (np.arange(max(1, round(length / side))) + 0.5) * side - 0.5 for length in shape
    )
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def camera_rays(points: np.ndarray, camera: Any) -> np.ndarray:
    """Return the unit directions of points in a view, (N, 3)."""
    rays = np.column_stack([camera.cam_from_img(points + PIXEL_CENTRE), np.ones(len(points))])
    return unit_vectors(rays)


def _focal(model: Any) -> float:
    """Return the focal length of a pycolmap model, px."""
    return float(next(iter(model.cameras.values())).focal_length_x)


def _pairs_of_model(
    model: Any, points: Sequence[np.ndarray], pairs: Pairs
) -> Iterator[tuple[tuple[int, int], tuple[np.ndarray, ...]]]:
    """Yield each pair of views of a pycolmap model, with two poses and the rays of the matches."""
    camera = next(iter(model.cameras.values()))
    poses = {k - 1: model.images[k].cam_from_world().matrix() for k in model.reg_image_ids()}
    rays = {view: camera_rays(points[view], camera) for view in poses}
    for (first, second), indices in pairs.items():
        if first in poses and second in poses:
            before, after = rays[first][indices[:, 0]], rays[second][indices[:, 1]]
            yield (first, second), (poses[first], poses[second], before, after)
