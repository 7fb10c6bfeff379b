"""Median of neighbours that look like a pixel."""

import numpy as np

Array = np.ndarray  # of float64


def weighted_median(
    values: Array,  # (H, W)
    frame: Array,  # (H, W)
    is_smoothed: Array,  # (H, W) bool
    is_used: Array,  # (H, W) bool
    *,
    # as for `tisfm.kernels.rigid.weighted_median.weighted_median`
    radius: int,
    grey_scale: float,
    same_share: float,
    max_own_weight: float,
) -> Array:  # (H, W)
    """Return the least value that is at least as large as values with half of the weight."""
    out = values.copy()
    for y, x in np.argwhere(is_smoothed):
        window = np.s_[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
        weights = 1 / (1 + ((frame[window] - frame[y, x]) / grey_scale) ** 2)
        weights *= is_used[window]
        is_own = np.abs(values[window] - values[y, x]) <= same_share * values[y, x]
        if weights[is_own].sum() > max_own_weight * weights.sum():
            continue
        used_values, used_weights = (part[is_used[window]] for part in (values[window], weights))
        order = np.argsort(used_values)
        total = np.cumsum(used_weights[order])
        if len(total):
            out[y, x] = used_values[order[np.searchsorted(total, total[-1] / 2)]]
    return out
