"""Calibration of the standard deviation of inverse depth: how often it covers the error."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_mask, check_unmasked
from tisfm.errors import InputError


def std_coverage(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    truth: ArrayLike,
    mask: ArrayLike | None = None,
) -> float:
    """Return the share of pixels whose error of inverse depth is within one standard deviation.

    It is 0.68 for correct standard deviations of normal errors.

    Parameters
    ----------
    inverse_depth, inverse_depth_std : array_like, shape (H, W)
        Estimate, in any unit, and its standard deviation. Before comparing, the true inverse depth
        is multiplied by the median ratio of estimated and true inverse depth, over the pixels where
        the estimate is positive.
    truth : array_like, shape (H, W)
        True depth; unknown where it is not finite and positive.
    mask : array_like, shape (H, W), optional
        Nonzero where pixels count.

    Returns
    -------
    float
        From 0 to 1, over the pixels that count and have a known truth. An infinite deviation covers
        any error, NaN covers none.

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
    >>> estimate = np.array([[0.5, 0.52], [0.48, 0.9]])
    >>> std_coverage(estimate, np.full((2, 2), 0.05), truth)
    0.75
    """
    error_ratio = error_in_deviations(inverse_depth, inverse_depth_std, truth, mask)
    return float((error_ratio <= 1).mean())


def error_in_deviations(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    truth: ArrayLike,
    mask: ArrayLike | None = None,
) -> NDArray[np.float64]:  # (M,) float64 ndarray: at least 0
    """Return the error of inverse depth in standard deviations, for the pixels that count.

    Parameters and exceptions are as for `std_coverage`. The result is 0 for an infinite deviation
    and NaN for a deviation of NaN.
    """
    estimate = check_unmasked(inverse_depth, "inverse_depth", np.float64)
    deviation = check_unmasked(inverse_depth_std, "inverse_depth_std", np.float64)
    true_depth = check_unmasked(truth, "truth", np.float64)
    is_compared = np.isfinite(true_depth) & (true_depth > 0)
    shapes = {"inverse_depth_std": deviation.shape, "truth": true_depth.shape}
    if mask is not None:
        shapes["mask"] = np.shape(mask)
    for name, shape in shapes.items():
        if shape != estimate.shape:
            raise InputError(
                f"inverse_depth is {estimate.shape} and {name} is {shape}: expected the same shape"
            )
    if mask is not None:
        is_compared &= check_mask(mask, "mask")
    ratio = estimate[is_compared] * true_depth[is_compared]
    if not (ratio > 0).any():
        raise InputError(
            f"no pixel of the {estimate.shape} inverse depth is positive where the truth is known "
            "and the mask allows: nothing can be compared"
        )
    error = np.abs(estimate[is_compared] - np.median(ratio[ratio > 0]) / true_depth[is_compared])
    with np.errstate(divide="ignore", invalid="ignore"):
        error_ratio = error / deviation[is_compared]
    error_ratio[(error == 0) & (deviation[is_compared] == 0)] = 0.0
    return error_ratio
