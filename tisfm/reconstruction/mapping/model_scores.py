"""How well models explain the matches of views: scores of models, and the area that they explain.

The score counts every match, with or without a triangulated point. If the camera moves forward, far
points often have no triangulated position. The number of triangulated observations may then prefer
a wrong path with sideways motion.

The area tells which motion is the motion of the static scene. A moving object may have more texture
than the static scene, and so more points.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tisfm.reconstruction.geometry.rays import unit_vectors
from tisfm.reconstruction.mapping.database import PIXEL_CENTRE
from tisfm.reconstruction.mapping.incremental import first_pair_tolerance
from tisfm.reconstruction.tracks.views import View

# Values without a stated source were set by hand.

# Grid points along the longer side of a frame; each belongs to the nearest matched point.
GRID_CELLS = 32
# px, if the longer side has 640: largest distance of an explained match from its epipolar line.
EPIPOLAR_TOLERANCE = 2.0

Pairs = Mapping[tuple[int, int], np.ndarray]


class MatchScore:
    """Scores models by all matches of views.

    The score of a match is 1/(1 + (d/s)²). d is the distance, px, of the point in the second view
    from the epipolar half line of the point in the first view, which begins at infinite depth. s is
    half the tolerance of first pairs.
    """

    def __init__(
        self,
        views: Sequence[View],
        # mapping of (int, int) to (N, 2) int array: for pairs of indices of views, indices of
        # matching points: tracks first, then detected ones
        pairs: Mapping[tuple[int, int], np.ndarray],
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> None:
        self._pairs, self._scale = pairs, first_pair_tolerance(max(shape)) / 2
        self._points = [np.vstack([view.observations.points, view.detected]) for view in views]

    def matches(
        self,
        views: Collection[int] | None = None,  # pycolmap's numbers of views, which begin with 1
    ) -> int:
        """Return the number of matches between views; by default of all."""
        if views is None:
            return sum(map(len, self._pairs.values()))
        inside = set(views)
        return sum(
            len(both)
            for (first, second), both in self._pairs.items()
            if first + 1 in inside and second + 1 in inside
        )

    def score(self, model: Any) -> float:
        """Return the sum of the scores of the matches between the views of a pycolmap model."""
        return sum(score for score, _ in self._of_pairs(model).values())

    def least_view(self, model: Any) -> float:
        """Return the mean match score of the worst view, divided by the median over all views.

        It is near 1 in a right model. It is small if one view has a wrong pose, though the model
        explains most matches.
        """
        sums: dict[int, np.ndarray] = {}
        for pair, score in self._of_pairs(model).items():
            for view in pair:
                sums[view] = sums.get(view, np.zeros(2)) + score
        means = [score / count for score, count in sums.values() if count]
        return float(min(means) / np.median(means)) if means and max(means) > 0 else 0.0

    def _of_pairs(self, model: Any) -> dict[tuple[int, int], tuple[float, int]]:
        """Return the sum of the scores, and the number, of the matches of every pair of views."""
        camera = next(iter(model.cameras.values()))
        poses = {k - 1: model.images[k].cam_from_world().matrix() for k in model.reg_image_ids()}
        rays = {view: camera_rays(self._points[view], camera) for view in poses}
        found = {}
        for (first, second), both in self._pairs.items():
            if first in poses and second in poses:
                before, after = rays[first][both[:, 0]], rays[second][both[:, 1]]
                away = half_line_distances(poses[first], poses[second], before, after)
                distance = camera.focal_length_x * away / self._scale
                found[first, second] = float((1 / (1 + distance**2)).sum()), len(both)
        return found


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

    Returns (N,) float64: distances in the second image, in focal lengths; infinite if the nearest
    position on the half line is not in front of the second camera.
    """
    rotation = pose1[:, :3] @ pose0[:, :3].T
    infinite = before @ rotation.T
    translation = pose1[:, 3] - rotation @ pose0[:, 3]
    seen = after / after[:, 2:]
    normal = np.cross(infinite, translation)
    slope = np.maximum(np.hypot(normal[:, 0], normal[:, 1]), 1e-12)
    of_line = np.abs((seen * normal).sum(axis=1)) / slope
    # Beyond infinity a point would lie behind the cameras; beyond the epipole, behind the first.
    beyond_infinity = (np.cross(infinite, after) * normal).sum(axis=1) < 0
    beyond_epipole = (np.cross(after, translation) * normal).sum(axis=1) < 0
    is_open = np.linalg.norm(normal, axis=1) < 1e-12  # no translation, or along the direction
    at_infinity = _distance_to(infinite, seen)
    at_epipole = _distance_to(np.broadcast_to(translation, seen.shape), seen)
    found = np.where(beyond_epipole, at_epipole, of_line)
    return np.where(beyond_infinity | is_open, at_infinity, found)


def _distance_to(direction: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the distances of points with z = 1 from directions; infinite for z ≤ 0."""
    z = np.where(direction[:, 2] > 1e-9, direction[:, 2], np.nan)
    away = np.hypot(*(seen - direction / z[:, None])[:, :2].T)
    return np.nan_to_num(away, nan=np.inf)


class Coverage:
    """Computes the share of the area of frames that models explain.

    A match of two views stands for the area nearest to its point in each view. A model explains a
    match that lies near its epipolar line. Triangulated points are not needed: a model has none
    where the scene is too far away to show parallax.
    """

    def __init__(
        self,
        views: Sequence[View],
        # mapping of (int, int) to (N, 2) int array: for pairs of indices of views, indices of
        # matching points: tracks first, then detected points
        pairs: Pairs,
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> None:
        self._pairs, self._limit = pairs, EPIPOLAR_TOLERANCE * max(shape) / 640
        self._points = [np.vstack([view.observations.points, view.detected]) for view in views]
        areas = self._areas(places_in(shape))
        self._worth = {
            (first, second): areas[first][both[:, 0]] + areas[second][both[:, 1]]
            for (first, second), both in pairs.items()
        }

    def explained(self, models: Sequence[Any]) -> dict[tuple[int, int], np.ndarray]:
        """Return, for each pair of views, the matches that any pycolmap reconstruction explains."""
        piece = {view - 1: k for k, one in enumerate(models) for view in one.reg_image_ids()}
        found = {
            (first, second): np.zeros(len(both), bool)
            for (first, second), both in self._pairs.items()
            if piece.get(first, -1) == piece.get(second, -1) or not {first, second} <= set(piece)
        }
        for model in models:
            camera = next(iter(model.cameras.values()))
            poses = {
                k - 1: model.images[k].cam_from_world().matrix() for k in model.reg_image_ids()
            }
            rays = {view: camera_rays(self._points[view], camera) for view in poses}
            for (first, second), both in self._pairs.items():
                if first in poses and second in poses:
                    before, after = rays[first][both[:, 0]], rays[second][both[:, 1]]
                    off = camera.focal_length_x * _off(poses[first], poses[second], before, after)
                    found[first, second] |= off < self._limit
        return found

    def share(self, explained: Mapping[tuple[int, int], np.ndarray]) -> float:
        """Return the explained share of the area that all matches stand for."""
        parts = [
            (self._worth[pair][fits].sum(), self._worth[pair].sum())
            for pair, fits in explained.items()
        ]
        part, whole = np.sum(parts, axis=0) if parts else (0.0, 0.0)
        return float(part / whole) if whole else 0.0

    def _areas(self, places: np.ndarray) -> list[np.ndarray]:
        """Return, by view, the share of grid points nearest to each matched point; else 0."""
        matched = [np.zeros(len(points), bool) for points in self._points]
        for (first, second), both in self._pairs.items():
            matched[first][both[:, 0]] = True
            matched[second][both[:, 1]] = True
        found = []
        for points, used in zip(self._points, matched, strict=True):
            area = np.zeros(len(points))
            if used.any():
                _, nearest = cKDTree(points[used]).query(places)
                area[used] = np.bincount(nearest, minlength=used.sum()) / len(places)
            found.append(area)
        return found


def places_in(shape: tuple[int, int]) -> np.ndarray:
    """Return (x, y) of grid points over a frame, (N, 2), px."""
    side = max(shape) / GRID_CELLS
    rows, columns = (
        (np.arange(max(1, round(length / side))) + 0.5) * side - 0.5 for length in shape
    )
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def camera_rays(points: np.ndarray, camera: Any) -> np.ndarray:
    """Return the unit directions of points in a view, (N, 3)."""
    rays = np.column_stack([camera.cam_from_img(points + PIXEL_CENTRE), np.ones(len(points))])
    return unit_vectors(rays)


def _off(pose0: np.ndarray, pose1: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the angles of directions to their epipolar planes, (N,), rad; poses are (3, 4)."""
    turn = pose1[:, :3] @ pose0[:, :3].T
    normal = np.cross(pose1[:, 3] - turn @ pose0[:, 3], before @ turn.T)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.abs((after * normal).sum(axis=1))
