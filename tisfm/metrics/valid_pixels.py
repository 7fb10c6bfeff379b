"""Which pixels of a ground truth are known, and which pixels count."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_mask
from tisfm.errors import InputError

MAX_KNOWN_VALUE = 1e9
"""Magnitude above which a true value stands for an unknown one, as in Middlebury's .flo files."""


def is_known(truth: NDArray) -> NDArray[np.bool_]:
    """Return where a ground truth is known."""
    # NaN compares as false, so it counts as unknown.
    return np.abs(truth) <= MAX_KNOWN_VALUE


def compared_pixels(mask: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return where pixels count: where the mask is nonzero, or everywhere without a mask."""
    if mask is None:
        return np.ones(shape, bool)
    is_compared = check_mask(mask, "mask")
    if is_compared.shape != shape:
        raise InputError(f"mask is {is_compared.shape}: expected the shape of the truth, {shape}")
    return is_compared
