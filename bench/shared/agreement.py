"""Agreement of a kernel with the reference, checked before either is timed."""

import numpy as np


def disagreement(actual: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest deviation, relative to the largest value of its component.

    Parameters
    ----------
    actual, expected : (k, …) array
    """
    if actual.shape != expected.shape:
        raise ValueError(f"the answer is {actual.shape} but the reference's is {expected.shape}")
    k = len(expected)
    deviation = np.abs(actual - expected).reshape(k, -1).max(axis=1)
    largest = np.abs(expected).reshape(k, -1).max(axis=1)
    return float((deviation / np.maximum(largest, np.finfo(np.float32).tiny)).max())


def check(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> float:
    """Return the disagreement, or raise an AssertionError where it is above the tolerance."""
    error = disagreement(actual, expected)
    if not error <= tolerance:  # NaN included
        raise AssertionError(
            f"the answer differs from the reference's by {error:.1e} of the largest value: "
            f"expected at most {tolerance:.1e}"
        )
    return error


def check_quantile(distance: np.ndarray, share: float, tolerance: float) -> float:
    """Return the distance that a share of the pixels keeps to, or raise as `check` does."""
    error = float(np.quantile(distance, share))
    if not error <= tolerance:
        raise AssertionError(
            f"{share:.0%} of the pixels agree with the reference to {error:.1e} px/frame: "
            f"expected {tolerance:.1e}"
        )
    return error
