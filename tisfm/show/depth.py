"""Depth as grey levels and as colours, near bright and far dark."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.show.arrays import as_map, check_limit, is_depth
from tisfm.show.palette import DEPTH_PERCENTILE, colors_of


def inverse_depth_limit(inverse_depth: ArrayLike, percentile: float = DEPTH_PERCENTILE) -> float:
    """Choose the top of the range of an inverse depth map.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. Only finite positive values count.
    percentile : float
        Share of the values that lie within the range, in percent, from 0 to 100.

    Returns
    -------
    float
        Top of the range, in the unit of `inverse_depth`; 0.0 if no value counts.

    Raises
    ------
    ValueError
        If `inverse_depth` is not (H, W) or `percentile` is outside 0 to 100.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import inverse_depth_limit
    >>> 0.9 < inverse_depth_limit(np.linspace(0, 1, 101)[None]) < 1
    True
    """
    values = as_map("inverse_depth", inverse_depth)
    if not 0 <= percentile <= 100:
        raise InputError(f"percentile is {percentile!r}, expected a number from 0 to 100")
    valid = values[is_depth(values)]
    return float(np.percentile(valid, percentile)) if valid.size else 0.0


def depth_grey(inverse_depth: ArrayLike, *, limit: float | None = None) -> NDArray[np.uint8]:
    """Show depth as grey levels, near bright and far dark, as in Fig. 3, 4, 6 and 8 of the paper.

    Grey is linear in inverse depth, from black at 0 (infinitely far) to white at `limit`.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. Values that are not finite and positive are black.
    limit : float, optional
        Inverse depth shown as white, nearer is white as well. The default is
        `inverse_depth_limit` of this map. Give all maps of a sequence the same limit: a range of
        its own for each makes the sequence flicker.

    Returns
    -------
    (H, W) uint8 ndarray
        Grey levels.

    Raises
    ------
    ValueError
        If `inverse_depth` is not (H, W) or `limit` is negative or not finite.

    References
    ----------
    H. Sekkati and A. Mitiche, Robotics and Autonomous Systems 55 (2007) 597-607, section 6,
    doi:10.1016/j.robot.2006.11.006.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import depth_grey
    >>> depth_grey(np.array([[0.0, 0.5, 1.0]]), limit=1.0).tolist()  # near is bright
    [[0, 128, 255]]
    """
    values = as_map("inverse_depth", inverse_depth)
    top = inverse_depth_limit(values) if limit is None else check_limit("limit", limit)
    if top == 0:
        return np.zeros(values.shape, dtype=np.uint8)
    # Clipped before scaling, so that neither overflows; what is not finite is set to 0 as well.
    shown = np.zeros(values.shape)
    np.minimum(values, top, out=shown, where=is_depth(values))
    shown /= top
    shown *= 255
    return np.rint(shown, out=shown).astype(np.uint8)


def depth_to_color(inverse_depth: ArrayLike, *, limit: float | None = None) -> NDArray[np.uint8]:
    """Show depth as colours, from black, infinitely far, through purple to pale yellow, near.

    The colours (magma) are linear in inverse depth and even to the eye.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. What is not finite is not known: grey. What is not positive is
        black, as if it were infinitely far.
    limit : float, optional
        Inverse depth of the brightest colour, as for `depth_grey`. Give all maps of a sequence the
        same limit.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Colours red, green, blue.

    Raises
    ------
    ValueError
        If `inverse_depth` is not (H, W) or `limit` is negative or not finite.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import depth_to_color
    >>> depth_to_color(two_blocks(48, 64).inverse_depth).shape
    (48, 64, 3)
    """
    values = as_map("inverse_depth", inverse_depth)
    top = inverse_depth_limit(values) if limit is None else check_limit("limit", limit)
    known = np.isfinite(values)
    share = np.where(known, 0.0, np.nan)
    if top > 0:  # clipped before it is divided, so that neither overflows
        np.clip(values, 0, top, out=share, where=known)
        share /= top
    return colors_of(share, "depth")
