"""A second view from one picture and its depth, and both in one red-cyan picture."""

import functools
import math
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.show.arrays import as_image, as_map, as_rgb, as_uint8, check_limit, require_same_size
from tisfm.show.depth import inverse_depth_limit

_DEFAULT_DISPARITY = 0.03  # of the width

# Least-squares matrices for red-cyan glasses: out = L left + R right, rows and columns R, G, B.
_MATRICES = {
    "2009": (
        ((0.437, 0.449, 0.164), (-0.062, -0.062, -0.024), (-0.048, -0.050, -0.017)),
        ((-0.011, -0.032, -0.007), (0.377, 0.761, 0.009), (-0.026, -0.093, 1.234)),
    ),
    "crt": (
        (
            (0.456100, 0.500484, 0.176381),
            (-0.0400822, -0.0378246, -0.0157589),
            (-0.0152161, -0.0205971, -0.00546856),
        ),
        (
            (-0.0434706, -0.0879388, -0.00155529),
            (0.378476, 0.733640, -0.0184503),
            (-0.0721527, -0.112961, 1.22640),
        ),
    ),
}


def second_view(image: ArrayLike, inverse_depth: ArrayLike, *, displacement: float) -> NDArray[Any]:
    """Make the view of a second camera, displaced along the X axis.

    By eq. 26 to 28 a point at column x1 of the given picture is at x2 = x1 - f d / Z in the other.
    It is drawn at the nearest column, and hides what is farther; a picture stays a picture of
    whole pixels. Columns that nothing reaches take the nearest pixel of their row.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        The given picture, of any real type.
    inverse_depth : (H, W) array_like
        Inverse depth 1/Z of each pixel, in any unit. Values that are negative or not finite count
        as 0, infinitely far.
    displacement : float
        f d, px times the unit of depth: displacement times inverse depth is the shift, px. Positive
        for a second camera to the right of the first.

    Returns
    -------
    (H, W) or (H, W, 3) ndarray
        The second view, of the type of `image`.

    Raises
    ------
    ValueError
        If a shape is wrong, the sizes differ, or `displacement` is not finite.

    Notes
    -----
    Of the pixels that reach one place, the nearest is the one farthest right in the given picture
    if the camera moves to the right: what shifts more to the left came from further right. The
    greatest (or least) column is therefore all that has to be found, and depths are never sorted.

    References
    ----------
    H. Sekkati and A. Mitiche, Robotics and Autonomous Systems 55 (2007) 597-607, appendix,
    doi:10.1016/j.robot.2006.11.006.
    """
    picture = as_image("image", image)
    depth = as_map("inverse_depth", inverse_depth)
    require_same_size("inverse_depth", depth, "image", picture)
    if not math.isfinite(displacement):
        raise ValueError(f"displacement is {displacement!r}, expected a finite number")
    if displacement < 0:
        # The mirror image of a camera that moves to the right.
        mirrored = second_view(picture[:, ::-1], depth[:, ::-1], displacement=-displacement)
        return np.ascontiguousarray(mirrored[:, ::-1])
    source = _fill_rows(_nearest_source(_shifts(depth, displacement)))
    height, width = source.shape
    # Over whole pixels, which is several times as fast as along an axis of three channels.
    pixels = picture.reshape(height * width, *picture.shape[2:])
    return np.take(pixels, source + width * np.arange(height)[:, None], axis=0, mode="clip")


def dubois(
    left: ArrayLike,
    right: ArrayLike,
    *,
    matrices: Literal["2009", "crt"] = "2009",
    linear: bool = True,
) -> NDArray[np.uint8]:
    """Combine the two views of a stereo pair in one picture for red-cyan glasses.

    Parameters
    ----------
    left, right : (H, W) or (H, W, 3) array_like
        Views of the left and right eye, sRGB: uint8, uint16 (divided by 257), or float (times 255
        if both are in [0, 1], but for overshoots).
    matrices : {"2009", "crt"}
        Least-squares matrices: the set of 2009, or the original set for CRT displays.
    linear : bool
        Whether to undo the sRGB transfer curve before the matrices and apply it after them. The
        default is True because the matrices were fitted to amounts of light, and the share of each
        eye's view that leaks through the other eye's filter, which their negative entries cancel,
        adds up as light. False applies them to the coded values, as much software does.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Anaglyph, red, green, blue, clipped to 0 to 255. Grey stays grey.

    Raises
    ------
    ValueError
        If a shape is wrong, the sizes differ, or `matrices` is unknown.

    References
    ----------
    E. Dubois, "A projection method to generate anaglyph stereo images", ICASSP 2001, vol. 3,
    1661-1664, doi:10.1109/ICASSP.2001.941256 (reference 31 of the paper).
    """
    views = as_image("left", left), as_image("right", right)
    require_same_size("right", views[1], "left", views[0])
    if matrices not in _MATRICES:
        raise ValueError(f"matrices is {matrices!r}, expected one of {sorted(_MATRICES)}")
    decode = _linear_from_srgb() if linear else np.arange(256, dtype=np.float32) / 255
    # Amounts of light have more steps than coded values, whose darkest ones lie close together.
    most, kind = (65535, cv2.CV_16U) if linear else (255, cv2.CV_8U)
    weights = np.array(_MATRICES[matrices], dtype=np.float32) * np.float32(most)
    lights = (
        cv2.transform(cv2.LUT(np.ascontiguousarray(as_rgb(view)), decode[None]), weight)
        for view, weight in zip(as_uint8(*views), weights, strict=True)
    )
    light_left, light_right = lights
    mixed = cv2.add(light_left, light_right, None, None, kind)  # rounded and clipped
    if linear:
        mixed = cv2.LUT(mixed, _srgb_from_linear()[None])
    return np.asarray(mixed, np.uint8)


def anaglyph(
    image: ArrayLike,
    inverse_depth: ArrayLike,
    *,
    max_disparity: float | None = None,
    limit: float | None = None,
    matrices: Literal["2009", "crt"] = "2009",
    linear: bool = True,
) -> NDArray[np.uint8]:
    """Make a picture for red-cyan glasses from one picture and its depth.

    The picture is the left eye's view; the right eye's is made by `second_view`. What is
    infinitely far lies in the plane of the picture, and what is near stands out in front of it.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture, sRGB: uint8, uint16, or float.
    inverse_depth : (H, W) array_like
        Inverse depth in any unit.
    max_disparity : float, optional
        Shift between the two views where the inverse depth is `limit`, px. Nearer points shift no
        further. The default is 3 % of the width.
    limit : float, optional
        Inverse depth of the greatest shift; by default `inverse_depth_limit`, the 95th percentile.
        Give all pictures of a sequence the same limit, or depth will pump.
    matrices, linear
        As in `dubois`.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Anaglyph, red, green, blue.

    Raises
    ------
    ValueError
        If a shape is wrong, the sizes differ, or a limit is negative or not finite.
    """
    picture = as_image("image", image)
    depth = as_map("inverse_depth", inverse_depth)
    require_same_size("inverse_depth", depth, "image", picture)
    shift = (
        _DEFAULT_DISPARITY * picture.shape[1]
        if max_disparity is None
        else check_limit("max_disparity", max_disparity)
    )
    top = inverse_depth_limit(depth) if limit is None else check_limit("limit", limit)
    share = np.zeros_like(depth)
    if top > 0:
        # A few wild depths must not be thrown across the picture.
        np.clip(depth, 0, top, out=share, where=np.isfinite(depth))
        share /= top
    right = second_view(picture, share, displacement=shift)
    return dubois(picture, right, matrices=matrices, linear=linear)


def _shifts(inverse_depth: NDArray[Any], displacement: float) -> NDArray[np.int32]:
    """Return f d / Z in whole pixels, no further than out of the picture."""
    width = inverse_depth.shape[1]
    valid = np.isfinite(inverse_depth) & (inverse_depth > 0)
    shift = np.zeros_like(inverse_depth)
    with np.errstate(over="ignore"):  # infinity is out of the picture as well
        np.multiply(inverse_depth, displacement, out=shift, where=valid)
    np.minimum(shift, width, out=shift)
    return np.rint(shift, out=shift).astype(np.int32)


def _nearest_source(shifts: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return, for each place of the second view, the column it shows, or -1 for none.

    Parameters
    ----------
    shifts : (H, W) int32 ndarray
        Shift to the left of each pixel, px, at least 0.

    Returns
    -------
    (H, W) int32 ndarray
        Column of the nearest of the pixels that land here.
    """
    height, width = shifts.shape
    margin = int(shifts.max(initial=0))  # what leaves the picture lands there, and is cut off
    columns = np.tile(np.arange(width, dtype=np.int32), (height, 1))
    starts = (margin + width) * np.arange(height)[:, None]
    targets = margin + columns - shifts
    source = np.full((height, margin + width), -1, dtype=np.int32)
    # Columns come in order, so that the last one stays: it is the greatest.
    source.reshape(-1)[(starts + targets).reshape(-1)] = columns.reshape(-1)
    # A surface that turns away is stretched: neighbours land two places apart. The place between
    # them belongs to that surface, and nothing behind it may shine through.
    stretched = np.flatnonzero(shifts[:, 1:] - shifts[:, :-1] == -1)
    row, column = np.divmod(stretched, max(1, width - 1))
    between = row, targets[row, column] + 1
    np.maximum.at(source, between, column.astype(np.int32))
    return source[:, margin:]


def _fill_rows(source: NDArray[np.int32]) -> NDArray[np.int32]:
    """Give each empty place (-1) what the nearest filled place of its row has.

    A row that is empty altogether, because all of it shifted out to the left, takes its last pixel.
    """
    height, width = source.shape
    flat = source.reshape(-1)  # a copy where there is a margin
    filled = np.flatnonzero(flat >= 0)
    empty = np.flatnonzero(flat < 0)
    following = np.searchsorted(filled, empty)
    # Places before the first row and after the last are filled as well, and far away.
    filled = np.concatenate([[-width - 1], filled, [(height + 1) * width]])
    before, after = filled[following], filled[following + 1]
    start = empty - empty % width
    gap_before = np.where(before >= start, empty - before, width)
    gap_after = np.where(after < start + width, after - empty, width)
    nearest = np.where(gap_before <= gap_after, before, after)
    nothing = np.minimum(gap_before, gap_after) == width
    nearest[nothing] = 0
    flat[empty] = np.where(nothing, width - 1, flat[nearest])
    return flat.reshape(height, width)


@functools.cache
def _linear_from_srgb() -> NDArray[np.float32]:
    """Return the light of each of the 256 coded values, from 0 to 1."""
    coded = np.arange(256) / 255
    low = coded / 12.92
    high = ((coded + 0.055) / 1.055) ** 2.4
    return np.where(coded <= 0.04045, low, high).astype(np.float32)


@functools.cache
def _srgb_from_linear() -> NDArray[np.uint8]:
    """Return the coded value of 65536 amounts of light: a step is 1/20 of a code at the darkest."""
    light = np.arange(65536) / 65535
    low = light * 12.92
    high = 1.055 * light ** (1 / 2.4) - 0.055
    return np.rint(np.where(light <= 0.0031308, low, high) * 255).astype(np.uint8)
