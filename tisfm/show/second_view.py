"""The view of a second camera beside the first, from one picture and its depth."""

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.show.arrays import as_image, as_map, require_same_size, valid_depth_mask

_MAX_SURFACE_DIFFERENCE = 1  # px, of the shifts of two pixels of one surface; set by hand


def second_view(
    image: ArrayLike,
    inverse_depth: ArrayLike,
    *,
    displacement: float,
    fill: Literal["nearest", "behind"] = "nearest",
) -> NDArray[Any]:
    """Make the view of a second camera, displaced along the X axis.

    By eq. 26 to 28 a point at column x1 of the given picture is at x2 = x1 - f d / Z in the second
    view.
    The point is drawn at the nearest column and hides farther points. Pixels are copied, not
    interpolated.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        The given picture, of any real type.
    inverse_depth : (H, W) array_like
        Inverse depth 1/Z of each pixel, in any unit. Values that are negative or not finite count
        as 0, infinitely far.
    displacement : float
        f d, in px times the unit of depth: displacement times inverse depth is the shift, px.
        Positive for a second camera to the right of the first camera.
    fill : {"nearest", "behind"}
        Content of columns that no point reaches: the nearest pixel of their row, as in the paper,
        or the mirror image of the farther side, so that near objects are not stretched.

    Returns
    -------
    (H, W) or (H, W, 3) ndarray
        The second view, of the type of `image`.

    Raises
    ------
    ValueError
        If a shape is wrong, the sizes differ, `displacement` is not finite, or `fill` is unknown.

    Notes
    -----
    If the camera moves to the right and several pixels reach one column, the nearest of them is the
    rightmost in the given picture, because it has shifted most to the left. So the pixel with the
    greatest column is drawn, and depths are never sorted.

    References
    ----------
    H. Sekkati and A. Mitiche, Robotics and Autonomous Systems 55 (2007) 597-607, appendix,
    doi:10.1016/j.robot.2006.11.006.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import second_view
    >>> scene = two_blocks(48, 64)
    >>> second_view(scene.frame0, scene.inverse_depth, displacement=4.0).shape
    (48, 64)
    """
    picture = as_image("image", image)
    inverse_depth_map = as_map("inverse_depth", inverse_depth)
    require_same_size("inverse_depth", inverse_depth_map, "image", picture)
    if not math.isfinite(displacement):
        raise InputError(f"displacement is {displacement!r}, expected a finite number")
    if fill not in ("nearest", "behind"):
        raise InputError(f"fill is {fill!r}, expected nearest or behind")
    if displacement < 0:
        # The mirror image of the view of a camera that moves to the right.
        mirrored_view = second_view(
            picture[:, ::-1], inverse_depth_map[:, ::-1], displacement=-displacement, fill=fill
        )
        return np.ascontiguousarray(mirrored_view[:, ::-1])
    shifts = _pixel_shifts(inverse_depth_map, displacement)
    source = _nearest_source(shifts)
    source = _fill_rows(source) if fill == "nearest" else _fill_from_behind(source, shifts)
    height, width = source.shape
    # Indexing whole pixels is several times as fast as indexing single channels.
    pixels = picture.reshape(height * width, *picture.shape[2:])
    return np.take(pixels, source + width * np.arange(height)[:, None], axis=0, mode="clip")


def _pixel_shifts(inverse_depth: NDArray[Any], displacement: float) -> NDArray[np.int32]:
    """Return f d / Z in whole pixels, limited to shifts just out of the picture.

    The limit keeps a pixel that leaves the picture on a different surface from a pixel just inside.
    """
    max_shift = inverse_depth.shape[1] + _MAX_SURFACE_DIFFERENCE + 1
    is_valid = valid_depth_mask(inverse_depth)
    shift = np.zeros_like(inverse_depth)
    with np.errstate(over="ignore"):  # infinity is out of the picture as well
        np.multiply(inverse_depth, displacement, out=shift, where=is_valid)
    np.minimum(shift, max_shift, out=shift)
    return np.rint(shift, out=shift).astype(np.int32)


def _nearest_source(
    # (H, W) int32 ndarray: shift to the left of each pixel, px, at least 0
    shifts: NDArray[np.int32],
) -> NDArray[np.int32]:  # (H, W) int32 ndarray: columns in the given picture
    """Return the column that each pixel of the second view shows, or -1 for none."""
    height, width = shifts.shape
    margin = int(shifts.max(initial=0))  # px: pixels that leave the picture land there
    columns = np.tile(np.arange(width, dtype=np.int32), (height, 1))
    starts = (margin + width) * np.arange(height)[:, None]
    targets = margin + columns - shifts
    source = np.full((height, margin + width), -1, dtype=np.int32)
    # Columns are written in ascending order, so the greatest column stays.
    source.reshape(-1)[(starts + targets).reshape(-1)] = columns.reshape(-1)
    # A slanted surface can be stretched: neighbours land two columns apart. The column between them
    # belongs to this surface and hides the surfaces behind.
    stretched_columns = np.flatnonzero(shifts[:, 1:] - shifts[:, :-1] == -1)
    row, column = np.divmod(stretched_columns, max(1, width - 1))
    gap_pixels = row, targets[row, column] + 1
    np.maximum.at(source, gap_pixels, column.astype(np.int32))
    return source[:, margin:]


def _fill_rows(source: NDArray[np.int32]) -> NDArray[np.int32]:
    """Give each empty column (−1) the source of the nearest filled column of its row.

    If all pixels of a row shifted out to the left, the row takes its last pixel.
    """
    height, width = source.shape
    flat_source = source.reshape(-1)  # a copy if `source` has a margin
    empty_pixels, left, right, left_gap, right_gap = _filled_neighbours(flat_source, width)
    nearest = np.where(left_gap <= right_gap, left, right)
    is_row_empty = np.minimum(left_gap, right_gap) == width
    nearest[is_row_empty] = 0
    flat_source[empty_pixels] = np.where(is_row_empty, width - 1, flat_source[nearest])
    return flat_source.reshape(height, width)


def _fill_from_behind(source: NDArray[np.int32], shifts: NDArray[np.int32]) -> NDArray[np.int32]:
    """Give each empty column (−1) the mirror image of the farther of both sides of its row.

    If both sides have the same depth, the side at the nearer column is used. If the mirror image is
    nearer to the camera or outside the picture, the pixel at the edge of the side is used.
    """
    height, width = source.shape
    flat_source = source.reshape(-1)
    empty_pixels, left, right, left_gap, right_gap = _filled_neighbours(flat_source, width)
    is_row_empty = np.minimum(left_gap, right_gap) == width
    left, right = (
        np.where(gap < width, side, 0) for gap, side in ((left_gap, left), (right_gap, right))
    )
    row = empty_pixels // width * width
    left_shift, right_shift = (
        shifts.reshape(-1)[row + flat_source[side]] for side in (left, right)
    )
    is_same_surface = np.abs(right_shift - left_shift) <= _MAX_SURFACE_DIFFERENCE
    is_farther = np.where(is_same_surface, right_gap < left_gap, right_shift < left_shift)
    is_from_right = (left_gap == width) | ((right_gap < width) & is_farther)
    edge_column = flat_source[np.where(is_from_right, right, left)]
    mirror_column = edge_column + np.where(is_from_right, right_gap, -left_gap)
    is_inside = (mirror_column >= 0) & (mirror_column < width)
    mirror_column = np.where(is_inside, mirror_column, edge_column)
    flat_shifts = shifts.reshape(-1)
    is_behind = (
        flat_shifts[row + mirror_column] <= flat_shifts[row + edge_column] + _MAX_SURFACE_DIFFERENCE
    )
    flat_source[empty_pixels] = np.where(
        is_row_empty, width - 1, np.where(is_behind, mirror_column, edge_column)
    )
    return flat_source.reshape(height, width)


def _filled_neighbours(
    flat_source: NDArray[np.int32], width: int
) -> tuple[
    NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]
]:
    """Return empty pixels, the next filled pixels to their left and right, and the distances.

    Pixels are indices into `flat_source`; distances are px. A distance is `width` if this side of
    the row has no filled column.
    """
    filled_pixels = np.flatnonzero(flat_source >= 0)
    empty_pixels = np.flatnonzero(flat_source < 0)
    next_filled = np.searchsorted(filled_pixels, empty_pixels)
    # Two additional, distant pixels count as filled: before the first row and after the last row.
    filled_pixels = np.concatenate([[-width - 1], filled_pixels, [len(flat_source) + width]])
    left, right = filled_pixels[next_filled], filled_pixels[next_filled + 1]
    start = empty_pixels - empty_pixels % width
    left_gap = np.where(left >= start, empty_pixels - left, width)
    right_gap = np.where(right < start + width, right - empty_pixels, width)
    return empty_pixels, left, right, left_gap, right_gap
