"""The point of a cloud, or the pixel of the picture in a frustum, that a click hits."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.results.frame import ResultFrame

CLICK_ANGLE = 0.012  # rad between a click and a point that it hits; set by hand
_SAME_SURFACE = 1.03  # ratio of distances up to which points are of one surface; set by hand


def picked_point(
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
    along = np.asarray(direction, float)
    along = along / np.linalg.norm(along)
    offset = np.asarray(positions, float) - np.asarray(origin, float)
    distance = offset @ along
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.linalg.norm(offset - distance[:, None] * along, axis=1) / distance
    near = (distance > 0) & (angle < max_angle)
    if not near.any():
        return None
    front = near & (distance <= _SAME_SURFACE * distance[near].min())
    return int(np.argmin(np.where(front, angle, np.inf)))


def picked_pixel(
    # origin, direction: (3,) array_like, in the axes of the camera
    origin: ArrayLike,
    direction: ArrayLike,
    frame: ResultFrame,
    distance: float,  # from the camera to the picture
) -> tuple[int, int, float] | None:  # (row, column, length) or None
    """Return row, column and distance of the pixel in a frustum that a ray hits."""
    start, along = np.asarray(origin, float), np.asarray(direction, float)
    along = along / np.linalg.norm(along)
    if abs(along[2]) < 1e-9:
        return None
    length = (distance - start[2]) / along[2]
    if length <= 0:
        return None
    hit = start + length * along
    height, width = frame.shape
    # viser draws a frustum about its axis, through the middle of the picture.
    column = round(hit[0] / distance * frame.camera.focal + (width - 1) / 2)
    row = round(hit[1] / distance * frame.camera.focal + (height - 1) / 2)
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
    fov, own = field_of_view(frame)
    return 2 * math.atan(math.tan(fov / 2) * max(1.0, own / aspect))


def frustum_scale(fov: float, aspect: float, distance: float) -> float:
    """Return the scale of a frustum with its picture at a distance from the camera.

    At scale 1, viser draws all frusta with the same volume, whatever their field of view.
    """
    y = math.tan(fov / 2)
    return distance * (y * y * aspect / 3) ** (1 / 3)
