"""Scores of models, by which they are compared: how well they explain the matches of views.

Every match counts, with or without a triangulated point. If the camera moves forward, far points
often have no triangulated position. The number of triangulated observations may then prefer a wrong
path with sideways motion.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tisfm.reconstruction.mapping.coverage import camera_rays
from tisfm.reconstruction.mapping.incremental import first_pair_tolerance
from tisfm.reconstruction.tracks.views import View


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
        self._points = [np.vstack([view.seen.points, view.detected]) for view in views]

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
