"""From where a frame is looked at, so that all of it is in sight."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

FOV = 0.9  # of browsers, rad, from top to bottom
USUAL_ASPECT = 0.85  # width over height of what browsers show between their panels
_TOWARDS = (-0.13, 0.22, 1.0)  # in the axes of the camera: from its right, from above
_NEAR = 2.0  # median depths: what is farther may be out of sight
_BEHIND = 0.5  # median depths behind the camera at least: it is in sight, and not in the way
_OUTSIDE = 2.0  # percent of the points that may be beyond each side
_MOST = 500  # points that are reckoned with
_FARTHER, _ROUNDS, _HALVINGS = 1.1, 40, 30
_MARGIN = 0.9  # of the picture that is filled


def overview(
    points: NDArray[np.floating],
    whole: NDArray[np.floating],
    *,
    up: ArrayLike = (0.0, -1.0, 0.0),
    aspect: float = USUAL_ASPECT,
) -> tuple[NDArray[np.float64], float]:
    """Return a pose from which a camera and its points are in sight, and how far these are.

    Parameters
    ----------
    points : (N, 3)
        In the axes of the camera. A few, and those that are far, may be out of sight.
    whole : (M, 3)
        All of these are in sight.
    up : (3,) array_like
        What points upwards there, in the same axes.
    aspect : float
        Width over height of the picture.

    Returns
    -------
    pose : (4, 4) float64
        In the axes of the points; X right, Y down, Z forward.
    distance : float
        Of the median of the points.
    """
    forward = np.array(_TOWARDS) / np.linalg.norm(_TOWARDS)
    across = np.cross(forward, np.asarray(up, float))
    if np.linalg.norm(across) < 1e-3:  # it looks straight up or down
        across = np.array((1.0, 0.0, 0.0))
    right = across / np.linalg.norm(across)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    places = np.concatenate([_usual(np.asarray(points, float)), np.asarray(whole, float)]) @ axes
    middle = float(np.median(places[:, 2]))
    most = np.tan(FOV / 2) * _MARGIN * np.array((aspect, 1.0))
    behind = _BEHIND * middle
    for _ in range(_ROUNDS):
        beside, half = zip(*(_centred(places, axis, -behind) for axis in (0, 1)), strict=True)
        if (np.array(half) <= most).all():
            break
        behind = _FARTHER * (behind + middle) - middle
    pose = np.eye(4)
    pose[:3, :3] = axes
    pose[:3, 3] = axes @ (*beside, -behind)
    return pose, middle + behind


def in_sight(
    points: NDArray[np.floating], pose: NDArray[np.floating], aspect: float = USUAL_ASPECT
) -> NDArray[np.bool_]:
    """Return which points, (N, 3), are well within the picture that is seen from a pose."""
    inside = (points - pose[:3, 3]) @ pose[:3, :3]
    half = np.tan(FOV / 2) * _MARGIN * np.array((aspect, 1.0))
    seen: NDArray[np.bool_] = (np.abs(inside[:, :2]) <= half * inside[:, 2:]).all(axis=1)
    return seen


def _usual(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return some points of all, without those that are far, and without a few at each side."""
    if not len(points):
        return points
    near = points[points[:, 2] <= _NEAR * np.median(points[:, 2])]
    slopes = near[:, :2] / near[:, 2:]
    low, high = np.percentile(slopes, (_OUTSIDE, 100 - _OUTSIDE), axis=0)
    kept = near[((slopes >= low) & (slopes <= high)).all(axis=1)]
    return kept[:: max(1, len(kept) // _MOST)]


def _centred(places: NDArray[np.float64], axis: int, depth: float) -> tuple[float, float]:
    """Return where an eye at a depth has all places about its middle, and their largest slope."""
    values, before = places[:, axis], np.maximum(places[:, 2] - depth, 1e-9)
    low, high = float(values.min()), float(values.max())
    for _ in range(_HALVINGS):
        eye = (low + high) / 2
        slopes = (values - eye) / before
        if slopes.min() + slopes.max() > 0:
            low = eye
        else:
            high = eye
    return eye, float(np.abs(slopes).max())
