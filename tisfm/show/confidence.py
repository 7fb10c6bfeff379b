"""Confidence as colours."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.show.arrays import as_map
from tisfm.show.palette import colors_of


def confidence_to_color(confidence: ArrayLike) -> NDArray[np.uint8]:
    """Show confidence as colours, from dark blue, 0, to yellow, 1.

    Parameters
    ----------
    confidence : (H, W) array_like
        In [0, 1]; what is beyond is shown as the end. NaN is not known: grey.

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
