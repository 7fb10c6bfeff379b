"""What a click hits: a point of the cloud, or a pixel of the picture in a frustum."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.results.frame import ViewFrame

WIDE = 0.012  # rad: how far beside a point a click may be
_BEHIND = 1.03  # of the distance of the nearest: points of one surface


def picked_point(
    origin: ArrayLike,
    direction: ArrayLike,
    positions: NDArray[np.floating],
    *,
    wide: float = WIDE,
) -> int | None:
    """Return the index of the point that a ray hits, None if there is none.

    Of those beside the ray the nearest surface counts, and of its points the one least beside.

    Parameters
    ----------
    origin, direction : (3,) array_like
    positions : (N, 3)
        In the same axes.
    wide : float
        How far beside a point the ray may be, rad.
    """
    if not len(positions):
        return None
    along = np.asarray(direction, float)
    along = along / np.linalg.norm(along)
    beside = np.asarray(positions, float) - np.asarray(origin, float)
    distance = beside @ along
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.linalg.norm(beside - distance[:, None] * along, axis=1) / distance
    near = (distance > 0) & (angle < wide)
    if not near.any():
        return None
    front = near & (distance <= _BEHIND * distance[near].min())
    return int(np.argmin(np.where(front, angle, np.inf)))


def picked_pixel(
    origin: ArrayLike, direction: ArrayLike, frame: ViewFrame, distance: float
) -> tuple[int, int, float] | None:
    """Return row and column of the picture in a frustum that a ray hits, and how far away.

    Parameters
    ----------
    origin, direction : (3,) array_like
        In the axes of the camera.
    frame : ViewFrame
    distance : float
        Of the picture before the camera.

    Returns
    -------
    (row, column, length) or None
    """
    start, along = np.asarray(origin, float), np.asarray(direction, float)
    along = along / np.linalg.norm(along)
    if abs(along[2]) < 1e-9:
        return None
    length = (distance - start[2]) / along[2]
    if length <= 0:
        return None
    hit = start + length * along
    height, width = frame.shape
    # A frustum is drawn about its axis, the middle of the picture.
    column = round(hit[0] / distance * frame.camera.focal + (width - 1) / 2)
    row = round(hit[1] / distance * frame.camera.focal + (height - 1) / 2)
    if 0 <= row < height and 0 <= column < width:
        return row, column, float(length)
    return None


def field_of_view(frame: ViewFrame) -> tuple[float, float]:
    """Return the vertical field of view of a frame, rad, and its width over its height."""
    height, width = frame.shape
    return 2 * math.atan(height / (2 * frame.camera.focal)), width / height


def following_fov(frame: ViewFrame, aspect: float) -> float:
    """Return the vertical field of view, rad, of a window in which all of a frame is in sight.

    Parameters
    ----------
    frame : ViewFrame
    aspect : float
        Width over height of the window.
    """
    fov, own = field_of_view(frame)
    return 2 * math.atan(math.tan(fov / 2) * max(1.0, own / aspect))


def frustum_scale(fov: float, aspect: float, distance: float) -> float:
    """Return the scale of a frustum whose picture lies so far before the camera.

    The browser draws one of scale 1 with a volume that does not depend on the field of view.
    """
    y = math.tan(fov / 2)
    return distance * (y * y * aspect / 3) ** (1 / 3)
