"""Views for two eyes, or of a swinging camera, from one picture and its depth."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.show.arrays import as_image, as_map, as_uint8, check_limit, require_same_size
from tisfm.show.color_maps import inverse_depth_limit
from tisfm.show.second_view import second_view

DISPARITY = 0.03
"""Default disparity budget: share of the width by which nearest point and infinity differ."""
MAX_DISPARITY = 0.2  # share of the width: largest disparity that eyes can fuse; set by hand

# Set by hand.
_UPSAMPLING = 2  # columns per pixel, for shifts by half pixels and smooth edges
_MIN_EDGE_CHANGE = 0.02  # change of nearness, in [0, 1], by interpolation at an edge of depth
_SOFT_EDGE_WIDTH = 3  # px: width of the blurred edge of an object, which shifts with the object
_MIN_CROP_SHARE = 0.5  # side of a picture without its border, as a share of its side


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

    The picture is the view of the left eye, ``eye=0``. Points nearer than the screen appear in
    front of the screen, farther points behind. Parts that only the other eye sees are filled by the
    mirror image of the background.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture, sRGB: uint8, uint16, or float.
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. A value that is not finite is replaced by the farther of the
        nearest known values to its left and right; zero and negative values are infinitely far.
    eye : float
        Position of the eye: 0 is the left eye, 1 the right eye, -1 the same distance to the left.
        Values between them are positions of a swinging camera.
    disparity : float
        Disparity budget: disparity, between the eyes 0 and 1, of a point at `limit` against
        infinity, as a share of the width, up to 0.2.
    max_disparity : float, optional
        The budget in px, instead of `disparity`.
    screen : float, optional
        Depth of the screen plane, which has no disparity, as a quantile of the depth of the
        picture: 0 for the farthest point, 1 for the nearest. By default the inverse depth of the
        screen is half of `limit`, the same for all pictures with one limit.
    screen_depth : float, optional
        Depth of the screen plane, in the inverse unit of `inverse_depth`, at least ``1 / limit``.
        Infinity puts the whole scene before the screen.
    limit : float, optional
        Inverse depth of the nearest points; by default `inverse_depth_limit`, the 95th percentile.
        Give all pictures of a sequence the same limit, so that depth does not fluctuate.
    crop : bool
        Whether to cut off the border without image content, equally wide for all eyes, and enlarge
        the rest.

    Returns
    -------
    (H, W) or (H, W, 3) uint8 ndarray
        The view of the eye.

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
    inverse_depth_map = as_map("inverse_depth", inverse_depth)
    require_same_size("inverse_depth", inverse_depth_map, "image", picture)
    if not -1 <= eye <= 1:
        raise InputError(f"eye is {eye!r}, expected a number from -1 to 1")
    parallax = _compute_parallax(
        inverse_depth_map,
        disparity=disparity,
        max_disparity=max_disparity,
        screen=screen,
        screen_depth=screen_depth,
        limit=limit,
    )
    (picture_uint8,) = as_uint8(picture)
    eye_view = picture_uint8 if eye == 0 else _render_eye(picture_uint8, parallax, eye)
    view = _crop_border(eye_view, parallax) if crop else eye_view
    return view.copy() if view is picture_uint8 else view  # never the array of the caller


def check_disparity(disparity: float) -> float:
    """Return the disparity; raise ValueError if it is out of range."""
    if not 0 < disparity <= MAX_DISPARITY:
        raise InputError(
            f"disparity is {disparity!r}: expected a share of the width, above 0, up to "
            f"{MAX_DISPARITY}"
        )
    return float(disparity)


def check_screen(screen: float | None, screen_depth: float | None) -> None:
    """Raise ValueError if both options are given, or an option is out of range."""
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
    """The shifts of pixels to the left for the right eye."""

    # (H, W) float32: nearness in [0, 1], from infinitely far to the limit
    nearness: NDArray[np.float32]
    shift: float  # shift of the nearest point against infinity, px
    screen: float  # nearness, in [0, 1], of points without shift


def _compute_parallax(
    inverse_depth: NDArray[np.floating[Any]],
    *,
    disparity: float,
    max_disparity: float | None,
    screen: float | None,
    screen_depth: float | None,
    limit: float | None,
) -> _Parallax:
    """Check the options, and return the shifts for an inverse depth, (H, W)."""
    width = inverse_depth.shape[1]
    shift = check_disparity(disparity) * width
    if max_disparity is not None:
        shift = check_limit("max_disparity", max_disparity)
    check_screen(screen, screen_depth)
    max_inverse_depth = (
        inverse_depth_limit(inverse_depth) if limit is None else check_limit("limit", limit)
    )
    if max_inverse_depth == 0:  # no depth: no shifts
        return _Parallax(nearness=np.zeros(inverse_depth.shape, np.float32), shift=0.0, screen=0.0)
    nearness = (
        np.clip(_fill_holes(inverse_depth), 0, max_inverse_depth) / max_inverse_depth
    ).astype(np.float32)
    screen_nearness = 0.5
    if screen is not None:
        known_nearness = nearness[nearness > 0]
        screen_nearness = float(np.quantile(known_nearness, screen)) if known_nearness.size else 0.0
    elif screen_depth is not None:
        screen_nearness = min(1.0, 1 / (screen_depth * max_inverse_depth))
    return _Parallax(nearness=nearness, shift=shift, screen=screen_nearness)


def _fill_holes(inverse_depth: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Fill unknown pixels with the farther of the nearest known values to the left and right.

    A row of unknown pixels is infinitely far.
    """
    is_known = np.isfinite(inverse_depth)
    if is_known.all():
        return inverse_depth
    from_left = _fill_from_left(inverse_depth, is_known)
    from_right = _fill_from_left(inverse_depth[:, ::-1], is_known[:, ::-1])[:, ::-1]
    farther_depth = np.fmin(from_left, from_right)
    return np.where(is_known, inverse_depth, np.nan_to_num(farther_depth, nan=0.0))


def _fill_from_left(
    values: NDArray[np.floating[Any]], is_known: NDArray[np.bool_]
) -> NDArray[np.floating[Any]]:
    """Return the last known value of the row up to each pixel, or NaN."""
    column = np.where(is_known, np.arange(values.shape[1]), -1)
    last_column = np.maximum.accumulate(column, axis=1)
    filled_values = np.take_along_axis(values, np.maximum(last_column, 0), axis=1)
    return np.where(last_column < 0, np.nan, filled_values)


def _render_eye(picture: NDArray[np.uint8], parallax: _Parallax, eye: float) -> NDArray[np.uint8]:
    """Return the view of an eye; pixels beyond the border are repeated or mirrored."""
    height, width = parallax.nearness.shape
    size = (_UPSAMPLING * width, height)
    # Without interpolation, parts of the picture that do not shift stay sharp.
    upsampled_picture = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)
    nearness = cv2.dilate(
        parallax.nearness, np.ones((_SOFT_EDGE_WIDTH, _SOFT_EDGE_WIDTH), np.uint8)
    )
    upsampled_nearness = cv2.resize(nearness, size, interpolation=cv2.INTER_LINEAR)
    # Interpolated nearness at an edge belongs to neither side: the nearest pixel replaces it.
    pixel_nearness = cv2.resize(nearness, size, interpolation=cv2.INTER_NEAREST)
    upsampled_nearness = np.where(
        np.abs(upsampled_nearness - pixel_nearness) < _MIN_EDGE_CHANGE,
        upsampled_nearness,
        pixel_nearness,
    )
    displacement = _UPSAMPLING * parallax.shift * eye
    eye_view = second_view(
        upsampled_picture, upsampled_nearness, displacement=displacement, fill="behind"
    )
    source_columns = np.arange(_UPSAMPLING * width) - round(displacement * parallax.screen)
    eye_view = eye_view[:, source_columns.clip(0, _UPSAMPLING * width - 1)]
    return np.asarray(cv2.resize(eye_view, (width, height), interpolation=cv2.INTER_AREA))


def _crop_border(picture: NDArray[np.uint8], parallax: _Parallax) -> NDArray[np.uint8]:
    """Cut off the border that lacks content for some eye, and enlarge the rest to full size."""
    height, width = picture.shape[:2]
    margin = math.ceil(parallax.shift * max(parallax.screen, 1 - parallax.screen))
    if margin == 0:
        return picture
    crop_share = max(_MIN_CROP_SHARE, 1 - 2 * margin / width)
    size = max(1, round(crop_share * width)), max(1, round(crop_share * height))
    center_image = cv2.getRectSubPix(picture, size, ((width - 1) / 2, (height - 1) / 2))
    return np.asarray(cv2.resize(center_image, (width, height), interpolation=cv2.INTER_CUBIC))
