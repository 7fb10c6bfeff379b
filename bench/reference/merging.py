"""Inverse depth of one view as several others show it, merged."""

import numpy as np

SUREST = 1e-3  # of the inverse depth: the least deviation that is believed


def merged(
    inverse_depths: np.ndarray, deviations: np.ndarray, alike: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of the sources that agree most at each pixel, and of their deviations.

    Parameters
    ----------
    inverse_depths, deviations : (N, H, W)
        0 where there is none.
    alike : float
        Sources agree that differ by a smaller share of the larger one.
    """
    known = inverse_depths > 0
    least = np.where(known, SUREST * inverse_depths, 1)
    votes = np.where(known, inverse_depths / np.maximum(deviations, least), 0) ** 2
    apart = np.abs(inverse_depths[:, None] - inverse_depths)
    agree = apart < alike * np.maximum(inverse_depths[:, None], inverse_depths)
    shares = votes * (agree & known & known[:, None])  # (N, N, H, W): of source j for source i
    best = shares.sum(axis=1).argmax(axis=0)
    chosen = np.take_along_axis(shares, best[None, None], axis=0)[0]
    total = np.maximum(chosen.sum(axis=0), np.finfo(float).tiny)
    depth, deviation = (
        (chosen * values).sum(axis=0) / total for values in (inverse_depths, deviations)
    )
    return depth, deviation
