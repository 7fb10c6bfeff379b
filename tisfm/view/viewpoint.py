"""Viewpoints that show a frame and its points, and the points or pixels that clicks hit."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.results.frame import ResultFrame

# Set by hand.
FOV = 0.9  # vertical field of view of browsers, rad
USUAL_ASPECT = 0.85  # width over height of a browser's view between its panels
# direction in which a browser looks, in the axes of the camera: from above, at the right
_VIEW_DIRECTION = (-0.13, 0.22, 1.0)
_MAX_DEPTH = 2.0  # in median depths: farther points may be outside the view
_MIN_DISTANCE = 0.5  # from the viewpoint to the camera, in median depths
_OUTSIDE_PERCENT = 2.0  # percent of the points that may be beyond each side
_MAX_POINTS = 500  # points that the viewpoint is fitted to
_DISTANCE_FACTOR = 1.1  # factor of the distance from one attempt to the next
_MAX_STEPS = 40  # attempts; together they multiply the distance by up to 45
_HALVINGS = 30  # steps of a bisection, which leave 1e-9 of the interval
_FILLED_SHARE = 0.9  # share of the view that points may fill


def overview(
    # (N, 3): in the axes of the camera. Far points, and a few others, may be outside the view.
    points: NDArray[np.floating],
    inner_points: NDArray[np.floating],  # (M, 3): further points; all of them are inside the view
    *,
    up: ArrayLike = (0.0, -1.0, 0.0),  # (3,) array_like: upward direction in the same axes
    aspect: float = USUAL_ASPECT,  # width over height of the view
) -> tuple[NDArray[np.float64], float]:
    """Return a viewpoint that shows a camera and its points, and the distance of the points.

    Returns the pose, (4, 4) float64, in the axes of the points (X right, Y down, Z forward); and
    the distance from the viewpoint to the median of the points.
    """
    forward = np.array(_VIEW_DIRECTION) / np.linalg.norm(_VIEW_DIRECTION)
    side = np.cross(forward, np.asarray(up, float))
    if np.linalg.norm(side) < 1e-3:  # the camera looks straight up or down
        side = np.array((1.0, 0.0, 0.0))
    right = side / np.linalg.norm(side)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    local = (
        np.concatenate([_sample(np.asarray(points, float)), np.asarray(inner_points, float)]) @ axes
    )
    middle = float(np.median(local[:, 2]))
    max_slope = np.tan(FOV / 2) * _FILLED_SHARE * np.array((aspect, 1.0))
    distance_behind = _MIN_DISTANCE * middle
    for _ in range(_MAX_STEPS):
        eyes, eye_slopes = zip(
            *(_centered_eye(local, axis, -distance_behind) for axis in (0, 1)), strict=True
        )
        if (np.array(eye_slopes) <= max_slope).all():
            break
        distance_behind = _DISTANCE_FACTOR * (distance_behind + middle) - middle
    pose = np.eye(4)
    pose[:3, :3] = axes
    pose[:3, 3] = axes @ (*eyes, -distance_behind)
    return pose, middle + distance_behind


def are_visible(
    points: NDArray[np.floating], pose: NDArray[np.floating], aspect: float = USUAL_ASPECT
) -> NDArray[np.bool_]:
    """Return which points, (N, 3), are well inside the view from a pose."""
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    max_slopes = np.tan(FOV / 2) * _FILLED_SHARE * np.array((aspect, 1.0))
    is_visible: NDArray[np.bool_] = (np.abs(local[:, :2]) <= max_slopes * local[:, 2:]).all(axis=1)
    return is_visible


def _sample(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a sample of the points, without far points and without a few at each side."""
    if not len(points):
        return points
    near_points = points[points[:, 2] <= _MAX_DEPTH * np.median(points[:, 2])]
    slopes = near_points[:, :2] / near_points[:, 2:]
    low, high = np.percentile(slopes, (_OUTSIDE_PERCENT, 100 - _OUTSIDE_PERCENT), axis=0)
    inner_points_sample = near_points[((slopes >= low) & (slopes <= high)).all(axis=1)]
    return inner_points_sample[:: max(1, len(inner_points_sample) // _MAX_POINTS)]


def _centered_eye(points: NDArray[np.float64], axis: int, depth: float) -> tuple[float, float]:
    """Return the coordinate of an eye that sees the points centred, and their largest slope."""
    values, distance = points[:, axis], np.maximum(points[:, 2] - depth, 1e-9)
    low, high = float(values.min()), float(values.max())
    for _ in range(_HALVINGS):
        eye = (low + high) / 2
        slopes = (values - eye) / distance
        if slopes.min() + slopes.max() > 0:
            low = eye
        else:
            high = eye
    return eye, float(np.abs(slopes).max())


CLICK_ANGLE = 0.012  # rad between a click and a point that it hits; set by hand
_SAME_SURFACE = 1.03  # ratio of distances up to which points are of one surface; set by hand


def find_clicked_point(
    # origin, direction: (3,) array_like
    origin: ArrayLike,
    direction: ArrayLike,
    positions: NDArray[np.floating],  # (N, 3): in the same axes
    *,
    max_angle: float = CLICK_ANGLE,  # largest angle between the ray and a point, rad
) -> int | None:
    """Return the index of the point that a ray hits; None without a hit.

    Only points of the nearest surface near the ray count; of these, the point nearest to the ray is
    hit.
    """
    if not len(positions):
        return None
    ray = np.asarray(direction, float)
    ray = ray / np.linalg.norm(ray)
    offset = np.asarray(positions, float) - np.asarray(origin, float)
    distance = offset @ ray
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.linalg.norm(offset - distance[:, None] * ray, axis=1) / distance
    is_near = (distance > 0) & (angle < max_angle)
    if not is_near.any():
        return None
    is_front = is_near & (distance <= _SAME_SURFACE * distance[is_near].min())
    return int(np.argmin(np.where(is_front, angle, np.inf)))


def find_clicked_pixel(
    # origin, direction: (3,) array_like, in the axes of the camera
    origin: ArrayLike,
    direction: ArrayLike,
    frame: ResultFrame,
    distance: float,  # from the camera to the picture
) -> tuple[int, int, float] | None:  # (row, column, length) or None
    """Return row, column and distance of the pixel in a frustum that a ray hits."""
    eye, ray = np.asarray(origin, float), np.asarray(direction, float)
    ray = ray / np.linalg.norm(ray)
    if abs(ray[2]) < 1e-9:
        return None
    length = (distance - eye[2]) / ray[2]
    if length <= 0:
        return None
    intersection = eye + length * ray
    height, width = frame.shape
    # viser draws a frustum about its axis, through the middle of the picture.
    column = round(intersection[0] / distance * frame.camera.focal + (width - 1) / 2)
    row = round(intersection[1] / distance * frame.camera.focal + (height - 1) / 2)
    if 0 <= row < height and 0 <= column < width:
        return row, column, float(length)
    return None


def field_of_view(frame: ResultFrame) -> tuple[float, float]:
    """Return the vertical field of view of a frame, rad, and its width over its height."""
    height, width = frame.shape
    return 2 * math.atan(height / (2 * frame.camera.focal)), width / height


def following_fov(
    frame: ResultFrame,
    aspect: float,  # width over height of the window
) -> float:
    """Return the vertical field of view, rad, of a window that shows the whole frame."""
    fov, frame_aspect = field_of_view(frame)
    return 2 * math.atan(math.tan(fov / 2) * max(1.0, frame_aspect / aspect))


def frustum_scale(fov: float, aspect: float, distance: float) -> float:
    """Return the scale of a frustum with its picture at a distance from the camera.

    At scale 1, viser draws all frusta with the same volume, whatever their field of view.
    """
    y = math.tan(fov / 2)
    return distance * (y * y * aspect / 3) ** (1 / 3)
