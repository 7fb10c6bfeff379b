"""What counts as known in a truth, and which pixels count."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import unmasked_mask
from tisfm.errors import InputError

UNKNOWN = 1e9


def is_known(truth: NDArray) -> NDArray[np.bool_]:
    """Return where a truth is known."""
    # A comparison with NaN is false, as wanted.
    return np.abs(truth) <= UNKNOWN


def counting(mask: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return where a mask counts: everywhere without one."""
    if mask is None:
        return np.ones(shape, bool)
    counting = unmasked_mask(mask, "mask")
    if counting.shape != shape:
        raise InputError(f"mask is {counting.shape}: expected the shape of the truth, {shape}")
    return counting
