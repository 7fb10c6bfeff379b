"""Viewpoints that show a frame and its points."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Set by hand.
FOV = 0.9  # vertical field of view of browsers, rad
USUAL_ASPECT = 0.85  # width over height of a browser's view between its panels
_DIRECTION = (-0.13, 0.22, 1.0)  # of the view in the axes of the camera: from its right and above
_MAX_DEPTH = 2.0  # in median depths: farther points may be outside the view
_MIN_DISTANCE = 0.5  # from the viewpoint to the camera, in median depths
_OUTSIDE = 2.0  # percent of the points that may be beyond each side
_MAX_POINTS = 500  # points that the viewpoint is fitted to
_STEP_BACK = 1.1  # factor of the distance from one attempt to the next
_MAX_STEPS = 40  # attempts, which multiply the distance by up to 45
_HALVINGS = 30  # of the interval of a bisection: to 1e-9 of it
_FILLED = 0.9  # share of the view that points may fill


def overview(
    # (N, 3): in the axes of the camera. Far points, and a few others, may be outside the view.
    points: NDArray[np.floating],
    whole: NDArray[np.floating],  # (M, 3): further points, all of which are inside the view
    *,
    up: ArrayLike = (0.0, -1.0, 0.0),  # (3,) array_like: upward direction in the same axes
    aspect: float = USUAL_ASPECT,  # width over height of the view
) -> tuple[NDArray[np.float64], float]:
    """Return a viewpoint that shows a camera and its points, and the distance of the points.

    Returns pose, (4, 4) float64: in the axes of the points; X right, Y down, Z forward; distance,
    from the viewpoint to the median of the points.
    """
    forward = np.array(_DIRECTION) / np.linalg.norm(_DIRECTION)
    across = np.cross(forward, np.asarray(up, float))
    if np.linalg.norm(across) < 1e-3:  # it looks straight up or down
        across = np.array((1.0, 0.0, 0.0))
    right = across / np.linalg.norm(across)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    local = np.concatenate([_sample(np.asarray(points, float)), np.asarray(whole, float)]) @ axes
    middle = float(np.median(local[:, 2]))
    most = np.tan(FOV / 2) * _FILLED * np.array((aspect, 1.0))
    distance_behind = _MIN_DISTANCE * middle
    for _ in range(_MAX_STEPS):
        beside, half = zip(
            *(_centred(local, axis, -distance_behind) for axis in (0, 1)), strict=True
        )
        if (np.array(half) <= most).all():
            break
        distance_behind = _STEP_BACK * (distance_behind + middle) - middle
    pose = np.eye(4)
    pose[:3, :3] = axes
    pose[:3, 3] = axes @ (*beside, -distance_behind)
    return pose, middle + distance_behind


def in_sight(
    points: NDArray[np.floating], pose: NDArray[np.floating], aspect: float = USUAL_ASPECT
) -> NDArray[np.bool_]:
    """Return which points, (N, 3), are well inside the view from a pose."""
    inside = (points - pose[:3, 3]) @ pose[:3, :3]
    half = np.tan(FOV / 2) * _FILLED * np.array((aspect, 1.0))
    seen: NDArray[np.bool_] = (np.abs(inside[:, :2]) <= half * inside[:, 2:]).all(axis=1)
    return seen


def _sample(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a sample of the points, without far points and without a few at each side."""
    if not len(points):
        return points
    near = points[points[:, 2] <= _MAX_DEPTH * np.median(points[:, 2])]
    slopes = near[:, :2] / near[:, 2:]
    low, high = np.percentile(slopes, (_OUTSIDE, 100 - _OUTSIDE), axis=0)
    kept = near[((slopes >= low) & (slopes <= high)).all(axis=1)]
    return kept[:: max(1, len(kept) // _MAX_POINTS)]


def _centred(points: NDArray[np.float64], axis: int, depth: float) -> tuple[float, float]:
    """Return the coordinate of a centred eye at a depth, and the largest slope of a point."""
    values, before = points[:, axis], np.maximum(points[:, 2] - depth, 1e-9)
    low, high = float(values.min()), float(values.max())
    for _ in range(_HALVINGS):
        eye = (low + high) / 2
        slopes = (values - eye) / before
        if slopes.min() + slopes.max() > 0:
            low = eye
        else:
            high = eye
    return eye, float(np.abs(slopes).max())
