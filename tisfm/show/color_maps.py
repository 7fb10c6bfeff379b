"""Maps of numbers as colours: depth, confidence, errors and uncertainty."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.show.arrays import as_map, check_limit, require_same_size, valid_depth_mask
from tisfm.show.palette import DEPTH_PERCENTILE, colors_of

ERROR_RANGE = (1 / 16, 16.0)
"""Default ends of the scale of flow errors, px: eight doublings, with 1 px in the middle."""
DEPTH_ERROR_RANGE = (1 / 64, 1.0)
"""Default ends of the scale of relative depth errors: six doublings, up to the depth itself."""
UNCERTAINTY_RANGE = (0.01, 0.64)
"""Default ends of the scale of relative uncertainty: six doublings from 1 %."""


def inverse_depth_limit(inverse_depth: ArrayLike, percentile: float = DEPTH_PERCENTILE) -> float:
    """Choose the inverse depth at the top of the colour range of a map.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. Only finite positive values are used.
    percentile : float
        Percentage of the values below the top of the range, from 0 to 100.

    Returns
    -------
    float
        Top of the range, in the unit of `inverse_depth`; 0.0 if no value is finite and positive.

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
    valid = values[valid_depth_mask(values)]
    return float(np.percentile(valid, percentile)) if valid.size else 0.0


def depth_grey(inverse_depth: ArrayLike, *, limit: float | None = None) -> NDArray[np.uint8]:
    """Show depth as grey levels, near bright and far dark, as in Fig. 3, 4, 6 and 8 of the paper.

    Grey is linear in inverse depth, from black at 0 (infinitely far) to white at `limit`.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. Values that are not finite and positive are black.
    limit : float, optional
        Inverse depth shown as white; nearer pixels are white as well. The default is
        `inverse_depth_limit` of this map. Give all maps of a sequence the same limit: separate
        limits make the sequence flicker.

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
    max_inverse_depth = (
        inverse_depth_limit(values) if limit is None else check_limit("limit", limit)
    )
    if max_inverse_depth == 0:
        return np.zeros(values.shape, dtype=np.uint8)
    # Values are clipped before they are scaled, so that nothing overflows.
    grey = np.zeros(values.shape)
    np.minimum(values, max_inverse_depth, out=grey, where=valid_depth_mask(values))
    grey /= max_inverse_depth
    grey *= 255
    return np.rint(grey, out=grey).astype(np.uint8)


def depth_to_color(inverse_depth: ArrayLike, *, limit: float | None = None) -> NDArray[np.uint8]:
    """Show depth as colours, from black, infinitely far, through purple to pale yellow, near.

    The colours (magma) are linear in inverse depth and perceptually uniform.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. Values that are not finite are unknown: grey. Zero and negative
        values are black, as infinitely far pixels are.
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
    max_inverse_depth = (
        inverse_depth_limit(values) if limit is None else check_limit("limit", limit)
    )
    is_known = np.isfinite(values)
    share = np.where(is_known, 0.0, np.nan)
    if max_inverse_depth > 0:
        # Values are clipped before they are divided, so that nothing overflows.
        np.clip(values, 0, max_inverse_depth, out=share, where=is_known)
        share /= max_inverse_depth
    return colors_of(share, "depth")


def confidence_to_color(confidence: ArrayLike) -> NDArray[np.uint8]:
    """Show confidence as colours, from dark blue, 0, to yellow, 1.

    Parameters
    ----------
    confidence : (H, W) array_like
        In [0, 1]. Values outside have the colour of the nearer end. NaN is unknown: grey.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Colours red, green, blue (cividis).

    Raises
    ------
    ValueError
        If `confidence` is not (H, W).

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import confidence_to_color
    >>> confidence_to_color(np.linspace(0, 1, 6).reshape(2, 3)).shape
    (2, 3, 3)
    """
    return colors_of(as_map("confidence", confidence), "confidence")


def error_to_color(
    error: ArrayLike, *, limits: tuple[float, float] = ERROR_RANGE
) -> NDArray[np.uint8]:
    """Show the length of flow errors as colours, from dark violet through green to yellow.

    The scale is logarithmic: each doubling of the error is the same step of the map (viridis,
    perceptually uniform). So one range shows both a tenth of a pixel and ten pixels, and pictures
    of all datasets can be compared.

    Parameters
    ----------
    error : (H, W) array_like
        Length of the error, px, such as from `tisfm.metrics.endpoint_error_map`. NaN means that
        the truth is unknown: grey.
    limits : (float, float)
        Errors at the two ends of the map, px. Smaller and larger errors have the end colours.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Colours red, green, blue.

    Raises
    ------
    ValueError
        If `error` is not (H, W) or the limits are not finite, positive and in order.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import error_to_color
    >>> error_to_color(np.array([[0.1, 1.0, 10.0]])).shape
    (1, 3, 3)
    """
    values = as_map("error", error)
    low, high = check_error_limits(limits)
    is_known = ~np.isnan(values)
    share = np.full(values.shape, np.nan)
    clipped_error = np.clip(values[is_known].astype(np.float64), low, high)
    # A difference of logarithms, because the ratio of both ends can overflow.
    span = math.log2(high) - math.log2(low)
    share[is_known] = (np.log2(clipped_error) - math.log2(low)) / span
    return colors_of(share, "error")


def uncertainty_to_color(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    *,
    limits: tuple[float, float] = UNCERTAINTY_RANGE,
) -> NDArray[np.uint8]:
    """Show the relative standard deviation of the depth in the colours of `error_to_color`.

    To first order, depth and inverse depth have the same relative deviation. Pixels with a certain
    depth are dark.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. A value that is not finite and positive is no depth: grey.
    inverse_depth_std : (H, W) array_like
        Standard deviation of `inverse_depth`, in the same unit. A value that is not finite is
        unknown: grey.
    limits : (float, float)
        Relative deviations at the two ends of the logarithmic scale. Smaller and larger deviations
        have the end colours.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Colours red, green, blue.

    Raises
    ------
    ValueError
        If a shape is wrong, sizes differ, or the limits are not finite, positive and in order.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import uncertainty_to_color
    >>> uncertainty_to_color(np.ones((2, 3)), np.full((2, 3), 0.05)).shape
    (2, 3, 3)
    """
    value, deviation = (
        as_map("inverse_depth", inverse_depth),
        as_map("inverse_depth_std", inverse_depth_std),
    )
    require_same_size("inverse_depth_std", deviation, "inverse_depth", value)
    is_known = valid_depth_mask(value) & np.isfinite(deviation)
    share = np.full(value.shape, np.nan)
    with np.errstate(over="ignore"):  # infinity has the colour of the upper limit
        np.divide(deviation, value, out=share, where=is_known, dtype=np.float64)
    return error_to_color(share, limits=limits)


def check_error_limits(limits: tuple[float, float]) -> tuple[float, float]:
    """Return both ends of a logarithmic scale; raise ValueError unless 0 < low < high."""
    low, high = limits
    if not (math.isfinite(low) and math.isfinite(high) and 0 < low < high):
        raise InputError(f"limits is {limits!r}, expected two finite numbers with 0 < low < high")
    return float(low), float(high)
