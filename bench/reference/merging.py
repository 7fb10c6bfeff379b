"""Merges the inverse depth of one view from several estimates."""

import numpy as np

SUREST = 1e-3  # least deviation that is trusted, as a share of the inverse depth


def merged(
    inverse_depths: np.ndarray, deviations: np.ndarray, alike: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the means of inverse depth and deviation over the sources that agree most at a pixel.

    Parameters
    ----------
    inverse_depths, deviations : (N, H, W)
        Of each source; inverse depth 0 is unknown.
    alike : float
        Two sources agree if they differ by less than this share of the larger inverse depth.
    """
    known = inverse_depths > 0
    least = np.where(known, SUREST * inverse_depths, 1)
    votes = np.where(known, inverse_depths / np.maximum(deviations, least), 0) ** 2
    apart = np.abs(inverse_depths[:, None] - inverse_depths)
    agree = apart < alike * np.maximum(inverse_depths[:, None], inverse_depths)
    shares = votes * (agree & known & known[:, None])  # (N, N, H, W): vote of source j for source i
    best = shares.sum(axis=1).argmax(axis=0)
    chosen = np.take_along_axis(shares, best[None, None], axis=0)[0]
    total = np.maximum(chosen.sum(axis=0), np.finfo(float).tiny)
    depth, deviation = (
        (chosen * values).sum(axis=0) / total for values in (inverse_depths, deviations)
    )
    return depth, deviation
