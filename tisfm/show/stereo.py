"""Views for two eyes, or of a camera that swings, from one picture and its depth."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.show.arrays import as_image, as_map, as_uint8, check_limit, require_same_size
from tisfm.show.depth import inverse_depth_limit
from tisfm.show.second_view import second_view

DISPARITY = 0.03
"""Default budget: how far the nearest moves against the farthest between two eyes, of the width."""
MOST_DISPARITY = 0.2  # of the width: eyes follow no more

_FINER = 2  # columns for one: views move by halves of a pixel, and edges are smooth
_EDGE = 0.02  # of the nearness: a larger change between neighbours is an edge
_RIM = 3  # px: edges of images are soft, and their rim goes with what is near
_LEAST_PART = 0.5  # of the picture that is left when its border is cut off


def stereo_view(
    image: ArrayLike,
    inverse_depth: ArrayLike,
    *,
    eye: float = 1.0,
    disparity: float = DISPARITY,
    max_disparity: float | None = None,
    screen: float | None = None,
    screen_depth: float | None = None,
    limit: float | None = None,
    crop: bool = True,
) -> NDArray[np.uint8]:
    """Make the view of another eye from one picture and its depth.

    The picture is the left eye's view, ``eye=0``. What is nearer than the screen stands out before
    it, what is farther lies behind. What only the other eye would see is filled by the mirror image
    of what is behind.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture, sRGB: uint8, uint16, or float.
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. Where it is not finite it is that of the farther side of the row,
        and what is not positive is infinitely far.
    eye : float
        Where it is: 1 for the right eye, -1 for a camera as far to the left, and what is between:
        a camera that swings.
    disparity : float
        Disparity budget: how far what is at `limit` moves against what is infinitely far between
        the eyes 0 and 1, as a share of the width, up to 0.2.
    max_disparity : float, optional
        The same in px, instead of `disparity`.
    screen : float, optional
        The plane of the screen, which has no parallax, as a quantile of the depth of the picture: 0
        for its farthest point, 1 for its nearest. By default it is in the middle of the budget,
        half as near as `limit`, which is the same for all pictures with one limit.
    screen_depth : float, optional
        The same as a depth, in the inverse unit of `inverse_depth`: nearer than ``1 / limit`` is
        as near. Infinity puts everything before the screen.
    limit : float, optional
        Inverse depth that counts as nearest; by default `inverse_depth_limit`, the 95th percentile.
        Give all pictures of a sequence the same limit, or depth will pump.
    crop : bool
        Whether to cut off the border that a view cannot show, as wide for all eyes, and enlarge
        the rest.

    Returns
    -------
    (H, W) or (H, W, 3) uint8 ndarray
        What the eye sees.

    Raises
    ------
    ValueError
        If a shape is wrong, the sizes differ, an option is out of its range or not finite, or both
        `screen` and `screen_depth` are given.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import stereo_view
    >>> scene = two_blocks(48, 64)
    >>> stereo_view(scene.frame0, scene.inverse_depth).shape[0]
    48
    """
    picture = as_image("image", image)
    depth = as_map("inverse_depth", inverse_depth)
    require_same_size("inverse_depth", depth, "image", picture)
    if not -1 <= eye <= 1:
        raise InputError(f"eye is {eye!r}, expected a number from -1 to 1")
    parallax = _parallax(
        depth,
        disparity=disparity,
        max_disparity=max_disparity,
        screen=screen,
        screen_depth=screen_depth,
        limit=limit,
    )
    (shown,) = as_uint8(picture)
    seen = shown if eye == 0 else _view_beside(shown, parallax, eye)
    view = _inner_part(seen, parallax) if crop else seen
    return view.copy() if view is shown else view  # never the picture that was given


def check_disparity(disparity: float) -> float:
    """Return a disparity, or raise ValueError if it is no share that eyes could follow."""
    if not 0 < disparity <= MOST_DISPARITY:
        raise InputError(
            f"disparity is {disparity!r}: expected a share of the width, above 0, up to "
            f"{MOST_DISPARITY}"
        )
    return float(disparity)


def check_screen(screen: float | None, screen_depth: float | None) -> None:
    """Raise ValueError unless at most one of both is given, and in its range."""
    if screen is not None and screen_depth is not None:
        raise InputError(
            f"screen is {screen!r} and screen_depth is {screen_depth!r}: give one of them"
        )
    if screen is not None and not 0 <= screen <= 1:
        raise InputError(f"screen is {screen!r}, expected a quantile, from 0 to 1")
    if screen_depth is not None and not screen_depth > 0:
        raise InputError(f"screen_depth is {screen_depth!r}, expected a depth above 0")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Parallax:
    """How far everything moves to the left for the right eye.

    Attributes
    ----------
    near : (H, W) float32
        In [0, 1], from infinitely far to the limit.
    shift : float
        px, of what is nearest against what is infinitely far.
    screen : float
        In [0, 1]: what is so near stays in place.
    """

    near: NDArray[np.float32]
    shift: float
    screen: float


def _parallax(
    depth: NDArray[np.floating[Any]],
    *,
    disparity: float,
    max_disparity: float | None,
    screen: float | None,
    screen_depth: float | None,
    limit: float | None,
) -> _Parallax:
    """Check the options, and return what they mean for an inverse depth."""
    width = depth.shape[1]
    shift = check_disparity(disparity) * width
    if max_disparity is not None:
        shift = check_limit("max_disparity", max_disparity)
    check_screen(screen, screen_depth)
    top = inverse_depth_limit(depth) if limit is None else check_limit("limit", limit)
    if top == 0:  # no depth: everything stays where it is
        return _Parallax(near=np.zeros(depth.shape, np.float32), shift=0.0, screen=0.0)
    near = (np.clip(_without_holes(depth), 0, top) / top).astype(np.float32)
    plane = 0.5
    if screen is not None:
        known = near[near > 0]
        plane = float(np.quantile(known, screen)) if known.size else 0.0
    elif screen_depth is not None:
        plane = min(1.0, 1 / (screen_depth * top))
    return _Parallax(near=near, shift=shift, screen=plane)


def _without_holes(inverse_depth: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return inverse depth with the farther of both sides of the row where it is not finite.

    A row that has nothing else is infinitely far.
    """
    known = np.isfinite(inverse_depth)
    if known.all():
        return inverse_depth
    from_left = _from_left(inverse_depth, known)
    from_right = _from_left(inverse_depth[:, ::-1], known[:, ::-1])[:, ::-1]
    farther = np.fmin(from_left, from_right)
    return np.where(known, inverse_depth, np.nan_to_num(farther, nan=0.0))


def _from_left(
    values: NDArray[np.floating[Any]], known: NDArray[np.bool_]
) -> NDArray[np.floating[Any]]:
    """Return the last known value of each row up to each pixel, NaN where there is none."""
    column = np.where(known, np.arange(values.shape[1]), -1)
    last = np.maximum.accumulate(column, axis=1)
    found = np.take_along_axis(values, np.maximum(last, 0), axis=1)
    return np.where(last < 0, np.nan, found)


def _view_beside(picture: NDArray[np.uint8], parallax: _Parallax, eye: float) -> NDArray[np.uint8]:
    """Return what an eye sees; beyond the border, pixels are repeated or mirrored."""
    height, width = parallax.near.shape
    size = (_FINER * width, height)
    wide = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)  # what stays is not blurred
    near = cv2.dilate(parallax.near, np.ones((_RIM, _RIM), np.uint8))
    depth = cv2.resize(near, size, interpolation=cv2.INTER_LINEAR)
    # Depth between the two sides of an edge belongs to neither.
    nearest = cv2.resize(near, size, interpolation=cv2.INTER_NEAREST)
    depth = np.where(np.abs(depth - nearest) < _EDGE, depth, nearest)
    displacement = _FINER * parallax.shift * eye
    seen = second_view(wide, depth, displacement=displacement, fill="behind")
    moved = np.arange(_FINER * width) - round(displacement * parallax.screen)
    seen = seen[:, moved.clip(0, _FINER * width - 1)]
    return np.asarray(cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA))


def _inner_part(picture: NDArray[np.uint8], parallax: _Parallax) -> NDArray[np.uint8]:
    """Return a view without the border that is made up for some eye, enlarged to its size."""
    height, width = picture.shape[:2]
    margin = math.ceil(parallax.shift * max(parallax.screen, 1 - parallax.screen))
    if margin == 0:
        return picture
    share = max(_LEAST_PART, 1 - 2 * margin / width)
    size = max(1, round(share * width)), max(1, round(share * height))
    inner = cv2.getRectSubPix(picture, size, ((width - 1) / 2, (height - 1) / 2))
    return np.asarray(cv2.resize(inner, (width, height), interpolation=cv2.INTER_CUBIC))
