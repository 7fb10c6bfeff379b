"""Two views in one picture for red-cyan glasses."""

from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.formats.srgb import linear_from_srgb, srgb_from_linear
from tisfm.show.arrays import as_image, as_rgb, as_uint8, require_same_size
from tisfm.show.stereo import DISPARITY, stereo_view

# Least-squares matrices for red-cyan glasses (Dubois): out = L left + R right, in order R, G, B.
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
        if both views are in [0, 1] apart from slight overshoots).
    matrices : {"2009", "crt"}
        Least-squares matrices: the set of 2009, or the original set for CRT displays.
    linear : bool
        Whether to undo the sRGB transfer curve before the matrices and apply it after them. The
        default is True because the matrices were fitted to linear light. Part of the view of one
        eye leaks through the filter of the other eye and adds light there; the negative entries of
        the matrices cancel this light. False applies the matrices to coded values, as much software
        does.

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

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import dubois
    >>> grey = np.full((4, 6), 128, np.uint8)
    >>> bool((abs(dubois(grey, grey).astype(int) - 128) < 3).all())  # grey stays grey
    True
    """
    views = as_image("left", left), as_image("right", right)
    require_same_size("right", views[1], "left", views[0])
    if matrices not in _MATRICES:
        raise InputError(f"matrices is {matrices!r}, expected one of {sorted(_MATRICES)}")
    linear_levels = linear_from_srgb() if linear else np.arange(256, dtype=np.float32) / 255
    # Linear light needs more steps than coded values, whose darkest levels lie close together.
    max_level, depth_type = (65535, cv2.CV_16U) if linear else (255, cv2.CV_8U)
    weights = np.array(_MATRICES[matrices], dtype=np.float32) * np.float32(max_level)
    weighted_views = (
        cv2.transform(cv2.LUT(np.ascontiguousarray(as_rgb(view)), linear_levels[None]), weight)
        for view, weight in zip(as_uint8(*views), weights, strict=True)
    )
    weighted_left, weighted_right = weighted_views
    mixture = cv2.add(weighted_left, weighted_right, None, None, depth_type)  # rounded and clipped
    if linear:
        mixture = cv2.LUT(mixture, srgb_from_linear()[None])
    return np.asarray(mixture, np.uint8)


def anaglyph(
    image: ArrayLike,
    inverse_depth: ArrayLike,
    *,
    disparity: float = DISPARITY,
    max_disparity: float | None = None,
    screen: float | None = None,
    screen_depth: float | None = None,
    limit: float | None = None,
    crop: bool = True,
    matrices: Literal["2009", "crt"] = "2009",
    linear: bool = True,
) -> NDArray[np.uint8]:
    """Make a picture for red-cyan glasses from one picture and its depth.

    The picture is the view of the left eye. `stereo_view` makes the view of the right eye, and cuts
    the same border off both views.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture, sRGB: uint8, uint16, or float.
    inverse_depth : (H, W) array_like
        Inverse depth in any unit.
    disparity, max_disparity, screen, screen_depth, limit, crop
        As in `stereo_view`: the disparity budget, as a share of the width or in px, the plane of
        the screen, the inverse depth of the nearest points, and whether the border is cut off.
    matrices, linear
        As in `dubois`.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Anaglyph, red, green, blue.

    Raises
    ------
    ValueError
        If a shape is wrong, the sizes differ, or an option is out of its range.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import anaglyph
    >>> scene = two_blocks(48, 64)
    >>> anaglyph(scene.frame0, scene.inverse_depth).shape
    (48, 64, 3)
    """
    left, right = (
        stereo_view(
            image,
            inverse_depth,
            eye=eye,
            disparity=disparity,
            max_disparity=max_disparity,
            screen=screen,
            screen_depth=screen_depth,
            limit=limit,
            crop=crop,
        )
        for eye in (0.0, 1.0)
    )
    return dubois(left, right, matrices=matrices, linear=linear)
