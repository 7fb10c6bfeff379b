"""Checks of the values that describe a scene."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
# Of a field: array_like when it is given, a read-only float64 array once it is checked.
Vector = Any


def finite(value: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """Return a read-only float64 copy; raise ValueError unless of this shape and finite."""
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}: expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {array.tolist()}: expected finite numbers")
    array.flags.writeable = False
    return array


def whole(least: int, **values: object) -> None:
    """Raise ValueError unless the values are whole numbers of at least `least`, which is 0 or 1."""
    for name, value in values.items():
        if not isinstance(value, int | np.integer) or value < least:
            kind = "positive" if least else "non-negative"
            raise ValueError(f"{name} is {value!r}: expected a {kind} whole number")
