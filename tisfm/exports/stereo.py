"""Views from beside the camera, made from a picture and its depth."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.show import dubois, second_view

_FINER = 2  # columns for one: views move by halves of a pixel, and edges are smooth
_EDGE = 0.02  # of the nearness: a larger change between neighbours is an edge


def nearness(inverse_depth: NDArray[np.float32], limit: float) -> NDArray[np.float32]:
    """Return inverse depth as a share of its limit, (H, W) float32 in [0, 1]; 0 for none."""
    share = np.zeros(inverse_depth.shape, np.float32)
    if limit > 0:
        valid = np.isfinite(inverse_depth) & (inverse_depth > 0)
        np.divide(inverse_depth, np.float32(limit), out=share, where=valid)
    return np.minimum(share, 1, out=share)


def without_holes(inverse_depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return inverse depth, (H, W) float32, with the farther of both sides where it is NaN.

    Sides are those of the row. A row that has nothing else is infinitely far.
    """
    known = np.isfinite(inverse_depth)
    if known.all():
        return inverse_depth
    from_left = _from_left(inverse_depth, known)
    from_right = _from_left(inverse_depth[:, ::-1], known[:, ::-1])[:, ::-1]
    farther = np.fmin(from_left, from_right)
    return np.where(known, inverse_depth, np.nan_to_num(farther, nan=0.0))


def _from_left(values: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the last known value of each row up to each pixel, NaN where there is none."""
    column = np.where(known, np.arange(values.shape[1]), -1)
    last = np.maximum.accumulate(column, axis=1)
    found = np.take_along_axis(values, np.maximum(last, 0), axis=1)
    return np.where(last < 0, np.float32(np.nan), found)


def view_beside(
    picture: NDArray[np.uint8],
    near: NDArray[np.float32],
    *,
    disparity: float,
    screen: float,
) -> NDArray[np.uint8]:
    """Return what a camera sees that stands beside the one of a picture.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) uint8
    near : (H, W) float32
        In [0, 1], as `nearness` returns it.
    disparity : float
        px: by so much the nearest moves to the left against what is infinitely far. Negative for a
        camera to the left.
    screen : float
        In [0, 1]: what is so near stays in place.

    Returns
    -------
    (H, W) or (H, W, 3) uint8
        Beyond the border, its pixels are repeated.
    """
    height, width = near.shape
    size = (_FINER * width, height)
    wide = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
    depth = cv2.resize(near, size, interpolation=cv2.INTER_LINEAR)
    # Depth between the two sides of an edge belongs to neither.
    nearest = cv2.resize(near, size, interpolation=cv2.INTER_NEAREST)
    depth = np.where(np.abs(depth - nearest) < _EDGE, depth, nearest)
    seen = second_view(wide, depth, displacement=_FINER * disparity)
    moved = np.arange(_FINER * width) - round(_FINER * disparity * screen)
    seen = seen[:, moved.clip(0, _FINER * width - 1)]
    return np.asarray(cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA))


def inner_part(picture: NDArray[np.uint8], *, disparity: float, screen: float) -> NDArray[np.uint8]:
    """Return a view without the border that `view_beside` made up, enlarged to its size."""
    height, width = picture.shape[:2]
    margin = math.ceil(abs(disparity) * max(screen, 1 - screen))
    share = max(0.5, 1 - 2 * margin / width)
    size = max(1, round(share * width)), max(1, round(share * height))
    inner = cv2.getRectSubPix(picture, size, ((width - 1) / 2, (height - 1) / 2))
    return np.asarray(cv2.resize(inner, (width, height), interpolation=cv2.INTER_CUBIC))


def anaglyph_of(
    picture: NDArray[np.uint8],
    near: NDArray[np.float32],
    *,
    disparity: float,
    screen: float,
) -> NDArray[np.uint8]:
    """Return a picture for red-cyan glasses, (H, W, 3) uint8, without a border.

    The picture is the left eye's view. Parameters as in `view_beside`: what is nearer than `screen`
    stands out before the screen.
    """
    right = view_beside(picture, near, disparity=disparity, screen=screen)
    left, right = (
        inner_part(view, disparity=disparity, screen=screen) for view in (picture, right)
    )
    return dubois(left, right)
