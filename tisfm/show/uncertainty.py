"""How uncertain a depth is, as colours."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.show.arrays import as_map, is_depth, require_same_size
from tisfm.show.error import error_to_color

UNCERTAINTY_RANGE = (0.01, 0.64)
"""Default ends of the scale of relative uncertainty: six doublings from 1 %."""


def uncertainty_to_color(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    *,
    limits: tuple[float, float] = UNCERTAINTY_RANGE,
) -> NDArray[np.uint8]:
    """Show the relative standard deviation of the depth in the colours of `error_to_color`.

    To first order that of the inverse depth is that of the depth. Sure depth is dark.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth in any unit. Where it is not finite and positive there is no depth: grey.
    inverse_depth_std : (H, W) array_like
        Its standard deviation, in the same unit. Where it is not finite nothing is known: grey.
    limits : (float, float)
        Relative deviations at the two ends of the logarithmic scale. Smaller and greater ones are
        shown as these.

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
    known = is_depth(value) & np.isfinite(deviation)
    share = np.full(value.shape, np.nan)
    with np.errstate(over="ignore"):  # infinite is shown as the upper limit
        np.divide(deviation, value, out=share, where=known, dtype=np.float64)
    return error_to_color(share, limits=limits)
