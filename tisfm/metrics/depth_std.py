"""How often a standard deviation of the depth covers its error."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import unmasked, unmasked_mask
from tisfm.errors import InputError


def std_coverage(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    truth: ArrayLike,
    mask: ArrayLike | None = None,
) -> float:
    """Return the share of pixels whose inverse depth is off by less than its standard deviation.

    If the deviations are right it is 0.68.

    Parameters
    ----------
    inverse_depth, inverse_depth_std : array_like, shape (H, W)
        Estimate, in any unit, and its standard deviation. The estimate is compared after scaling
        by the median of the ratio to the truth, over the pixels where it is positive.
    truth : array_like, shape (H, W)
        True depth; unknown where it is not finite and positive.
    mask : array_like, shape (H, W), optional
        Nonzero where pixels count.

    Returns
    -------
    float
        From 0 to 1, of the pixels that count and whose truth is known. A deviation that is
        infinite covers everything, one that is NaN nothing.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or no pixel that counts has a known truth and a
        positive estimate.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import std_coverage
    >>> truth = np.full((2, 2), 0.5)
    >>> found = np.array([[0.5, 0.52], [0.48, 0.9]])
    >>> std_coverage(found, np.full((2, 2), 0.05), truth)
    0.75
    """
    times = error_in_deviations(inverse_depth, inverse_depth_std, truth, mask)
    return float((times <= 1).mean())


def error_in_deviations(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    truth: ArrayLike,
    mask: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Return how many standard deviations the inverse depth is off, of the pixels that count.

    Parameters and errors are those of `std_coverage`. What has an infinite deviation is off by
    none, what has no deviation (NaN) by NaN.

    Returns
    -------
    (M,) float64 ndarray
        At least 0.
    """
    found = unmasked(inverse_depth, "inverse_depth", np.float64)
    deviation = unmasked(inverse_depth_std, "inverse_depth_std", np.float64)
    true = unmasked(truth, "truth", np.float64)
    counts = np.isfinite(true) & (true > 0)
    shapes = {"inverse_depth_std": deviation.shape, "truth": true.shape}
    if mask is not None:
        shapes["mask"] = np.shape(mask)
    for name, shape in shapes.items():
        if shape != found.shape:
            raise InputError(
                f"inverse_depth is {found.shape} and {name} is {shape}: expected the same shape"
            )
    if mask is not None:
        counts &= unmasked_mask(mask, "mask")
    ratio = found[counts] * true[counts]
    if not (ratio > 0).any():
        raise InputError(
            f"no pixel of the {found.shape} inverse depth is positive where the truth is known and "
            "counts"
        )
    error = np.abs(found[counts] - np.median(ratio[ratio > 0]) / true[counts])
    with np.errstate(divide="ignore", invalid="ignore"):
        off = error / deviation[counts]
    off[(error == 0) & (deviation[counts] == 0)] = 0.0
    return off
