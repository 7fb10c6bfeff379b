"""The median of more positive values than memory holds."""

import numpy as np
from numpy.typing import NDArray

_FINENESS = 1e-4  # of a bin, natural logarithm
_REACH = 70.0  # of the logarithm, either way: beyond float32's


class LogMedian:
    """Collects positive values, and tells their median within 0.01 %.

    Values are counted in bins of their logarithm, so that memory does not grow with their number.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(round(2 * _REACH / _FINENESS), np.int64)

    def add(self, values: NDArray[np.float64]) -> None:
        """Count positive values, of any shape."""
        bins = ((np.log(values).ravel() + _REACH) / _FINENESS).astype(np.int64)
        np.add.at(self._counts, bins.clip(0, len(self._counts) - 1), 1)

    def median(self) -> float | None:
        """Return their median, None of none."""
        total = int(self._counts.sum())
        if not total:
            return None
        cumulative = np.cumsum(self._counts)
        low, high = np.searchsorted(cumulative, [(total + 1) // 2, total // 2 + 1])
        return float(np.exp(((low + high) / 2 + 0.5) * _FINENESS - _REACH))
