"""How well models explain the matches of views: the number by which models are compared.

Every match counts, not only those that were triangulated. Where the camera goes forward, far points
often have no triangulated position. The number of triangulated observations may then prefer a wrong
path that goes sideways.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tisfm.reconstruction.cover import rays_of
from tisfm.reconstruction.database import View
from tisfm.reconstruction.growing import first_pair_tolerance


class MatchScore:
    """Scores models by all matches of views.

    The score of a match is 1/(1 + (d/s)²). d is the distance, px, of the point in the second view
    from the half line of places where the point of the first view may be seen, which begins at
    infinite depth. s is half the tolerance of first pairs.

    Parameters
    ----------
    views : sequence of View
    pairs : mapping of (int, int) to (N, 2) int array
        For pairs of indices of views, indices of matching points: tracks first, then detected ones.
    shape : (int, int)
        Height and width of the frames, px.
    """

    def __init__(
        self,
        views: Sequence[View],
        pairs: Mapping[tuple[int, int], np.ndarray],
        shape: tuple[int, int],
    ) -> None:
        self._pairs, self._scale = pairs, first_pair_tolerance(max(shape)) / 2
        self._points = [np.vstack([view.seen.points, view.detected]) for view in views]

    def matches(self, views: Collection[int] | None = None) -> int:
        """Return the number of matches between views; by default of all.

        Parameters
        ----------
        views : collection of int, optional
            pycolmap's numbers of views, which begin with 1.
        """
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
        camera = next(iter(model.cameras.values()))
        poses = {k - 1: model.images[k].cam_from_world().matrix() for k in model.reg_image_ids()}
        rays = {view: rays_of(self._points[view], camera) for view in poses}
        total = 0.0
        for (first, second), both in self._pairs.items():
            if first in poses and second in poses:
                before, after = rays[first][both[:, 0]], rays[second][both[:, 1]]
                angle = half_line_angles(poses[first], poses[second], before, after)
                distance = camera.focal_length_x * angle / self._scale
                total += float((1 / (1 + distance**2)).sum())
        return total


def half_line_angles(
    pose0: np.ndarray, pose1: np.ndarray, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """Return the angles between directions and the half lines where they may lie.

    Parameters
    ----------
    pose0, pose1 : (3, 4) array
        World to camera, of two views.
    before, after : (N, 3) array
        Unit directions to the same points in the first and the second view.

    Returns
    -------
    (N,) float64
        Angles, rad, between `after` and the arc from the direction of the point at infinite depth
        to the direction of the first camera.
    """
    rotation = pose1[:, :3] @ pose0[:, :3].T
    infinite = before @ rotation.T
    translation = pose1[:, 3] - rotation @ pose0[:, 3]
    to_end = np.linalg.norm(after - infinite, axis=1)
    at_infinity = 2 * np.arcsin(np.minimum(to_end / 2, 1))
    normal = np.cross(infinite, translation)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.maximum(length, 1e-12)
    off_plane = np.abs(np.arcsin(np.clip((after * normal).sum(axis=1), -1, 1)))
    # Beyond infinity, which is behind the camera: the end of the half line is nearest.
    behind = (np.cross(infinite, after) * normal).sum(axis=1) < 0
    return np.where(behind | (length[:, 0] < 1e-12), at_infinity, off_plane)
