"""The colours of all pictures: maps of numbers, categories, and unknown pixels.

Each kind of number has one map of colours. All three are perceptually uniform and become brighter
from end to end, so that they are readable with a colour vision deficiency and in grey print.
Unknown pixels are grey: this grey differs clearly from the colours of all maps.

References
----------
Magma and viridis: S. van der Walt and N. Smith, maps of Matplotlib 2 (2015). Cividis: J. Nuñez,
C. Anderton and R. Renslow, PLOS ONE 13 (2018) e0199239, doi:10.1371/journal.pone.0199239. The first
seven categories: M. Okabe and K. Ito, Color Universal Design (2002).
"""

from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError

Quantity = Literal["depth", "confidence", "error"]

UNKNOWN_COLOR = (200, 200, 200)
"""Red, green and blue of unknown pixels, in all pictures except flow and grey levels.

A light grey, because with a colour vision deficiency darker greys look like the middle of a map.
"""

DEPTH_PERCENTILE = 95.0
"""Percentage of inverse depths inside the range of a picture; set by hand."""
FLOW_PERCENTILE = 98.0
"""Percentage of lengths of motion inside the range of a picture; set by hand."""

TEXT_COLOR = "#0a0b0c"  # lines and text
GRID_COLOR = "#8c8c8c"  # grids and frames
RESULT_COLOR = "#0072b2"  # curves of results
CONTRAST_COLOR = "#d55e00"  # curves that contrast with results
OCCLUSION_COLOR = (255, 0, 60)  # pixels that are not visible in the next frame
_COLOR_MAPS = {
    "depth": cv2.COLORMAP_MAGMA,
    "confidence": cv2.COLORMAP_CIVIDIS,
    "error": cv2.COLORMAP_VIRIDIS,
}
# Red, green, blue: the static scene, then the seven colours of Okabe and Ito. Each further colour
# has the greatest distance from all earlier colours, with normal vision and with missing green or
# red cones.
_CATEGORY_COLORS = np.array(
    [
        (191, 191, 191),
        (230, 159, 0),
        (86, 180, 233),
        (0, 158, 115),
        (240, 228, 66),
        (0, 114, 178),
        (213, 94, 0),
        (204, 121, 167),
        (0, 0, 255),
        (153, 255, 153),
        (102, 102, 255),
        (102, 51, 0),
        (0, 51, 153),
        (153, 0, 102),
        (102, 153, 255),
        (255, 51, 102),
    ],
    np.uint8,
)


def color_ramp(quantity: Quantity) -> NDArray[np.uint8]:
    """Return the colours of a kind of number, from the smallest number to the largest.

    Parameters
    ----------
    quantity : {"depth", "confidence", "error"}
        Inverse depth, far to near; confidence, 0 to 1; or errors and deviations, small to large.

    Returns
    -------
    (256, 3) uint8 ndarray
        Colours red, green, blue.

    Raises
    ------
    ValueError
        If `quantity` is unknown.

    Examples
    --------
    >>> from tisfm.show import color_ramp
    >>> color_ramp("depth").shape
    (256, 3)
    """
    if quantity not in _COLOR_MAPS:
        expected = ", ".join(get_args(Quantity))
        raise InputError(f"quantity is {quantity!r}, expected one of {expected}")
    levels = np.arange(256, dtype=np.uint8)[:, None]
    return np.ascontiguousarray(cv2.applyColorMap(levels, _COLOR_MAPS[quantity])[:, 0, ::-1])


def colors_of(
    # (H, W) ndarray: from 0 to 1. Values outside have the colour of the nearer end. NaN has the
    # colour of unknown pixels.
    share: NDArray[np.floating],
    quantity: Quantity,  # as for `color_ramp`
) -> NDArray[np.uint8]:
    """Return the colours of shares of a range, (H, W, 3)."""
    is_known = ~np.isnan(share)
    levels = np.zeros(share.shape)
    np.clip(share, 0, 1, out=levels, where=is_known)
    codes = np.rint(255 * levels).astype(np.uint8)
    bgr = cv2.applyColorMap(codes, _COLOR_MAPS[quantity])
    colors: NDArray[np.uint8] = np.ascontiguousarray(bgr[..., ::-1])
    colors[~is_known] = UNKNOWN_COLOR
    return colors


def category_colors(count: int) -> NDArray[np.uint8]:
    """Return colours of labels, (count, 3): first the static scene; they repeat after 15 labels."""
    return colors_of_categories(np.arange(count))


def colors_of_categories(numbers: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return the colours of labels from 0, (..., 3), as `category_colors` does."""
    object_index = 1 + (numbers - 1) % (len(_CATEGORY_COLORS) - 1)
    colors: NDArray[np.uint8] = _CATEGORY_COLORS[np.where(numbers == 0, 0, object_index)]
    return colors


def as_hex(color: NDArray[np.uint8]) -> str:
    """Return a colour as ``#rrggbb``."""
    return "#" + bytes(int(level) for level in color).hex()
