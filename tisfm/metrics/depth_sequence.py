"""Errors of the depth of single frames of a sequence, with one scale for all frames."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.metrics.valid_pixels import is_known

# Definitions of these measures, set by hand:
CERTAIN_SHARE = 0.4  # share of the pixels: those with the smallest relative deviation
MAX_ERROR = 3.0  # relative error to which the error of a pixel is limited
MAX_DEPTH_DIFFERENCE = 0.02  # relative difference of two depths of one visible point
MIN_DEPTH_RATIO = 0.1  # lower limit of an estimate, divided by the smallest true depth
MAX_DEPTH_RATIO = 10.0  # upper limit of an estimate, divided by the largest true depth


def limited_error(inverse_depth: ArrayLike, truth: ArrayLike, *, scale: float = 1.0) -> float:
    """Return the mean |d - d*| / d* over all pixels with known truth.

    Parameters
    ----------
    inverse_depth : array_like, shape (H, W)
        Estimate. A pixel without an estimate (not finite and positive) counts as 10 max d*.
    truth : array_like, shape (H, W)
        True depth d*; unknown where it is not finite and positive.
    scale : float, default 1
        Factor of the depth d, which is then limited to [0.1 min d*, 10 max d*].

    Returns
    -------
    float
        As `DepthErrors.abs_rel_all`, with a given scale; 1 if no pixel has an estimate.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or the truth is unknown everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import limited_error
    >>> truth = np.full((3, 4), 2.0)
    >>> limited_error(1 / (1.25 * truth), truth)
    0.25
    """
    errors, _ = relative_errors_of_depth(inverse_depth, truth, scale=scale)
    return float(errors.mean())


def relative_errors_of_depth(
    # inverse_depth, truth, scale: as for `limited_error`
    inverse_depth: ArrayLike,
    truth: ArrayLike,
    *,
    scale: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return limited |d - d*| / d* of the pixels with known truth, (K,), and their mask, (H, W)."""
    inverse, true_depth, has_truth = _check_maps(inverse_depth, truth)
    inverse, true_depth = inverse[has_truth], true_depth[has_truth]
    has_estimate = _has_estimate(inverse)
    if not has_estimate.any():
        return np.ones(len(true_depth)), has_truth
    max_depth = MAX_DEPTH_RATIO * true_depth.max()
    depth = np.full(len(true_depth), max_depth)
    depth[has_estimate] = scale / inverse[has_estimate]
    depth = depth.clip(MIN_DEPTH_RATIO * true_depth.min(), max_depth)
    return np.abs(depth - true_depth) / true_depth, has_truth


def certain_error(
    inverse_depth: ArrayLike,
    deviation: ArrayLike,
    truth: ArrayLike,
    *,
    scale: float = 1.0,
    share: float = CERTAIN_SHARE,
) -> float:
    """Return the mean |d - d*| / d* of the pixels with the smallest relative deviation.

    Parameters
    ----------
    inverse_depth, deviation : array_like, shape (H, W)
        Estimate and its standard deviation, in one unit.
    truth : array_like, shape (H, W)
        True depth d*; unknown where it is not finite and positive.
    scale : float, default 1
        Factor of the depth before comparing.
    share : float, default 0.4
        Share of the pixels with known truth that are compared. The error of a pixel is limited to
        3; a pixel without an estimate has the error 3.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or the truth is unknown everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import certain_error
    >>> truth = np.full((2, 2), 2.0)
    >>> inverse_depth = np.array([[0.5, 0.5], [0.4, 0.4]])  # the second row is wrong
    >>> deviation = np.array([[0.01, 0.01], [0.2, 0.2]])  # and uncertain
    >>> certain_error(inverse_depth, deviation, truth, share=0.5)
    0.0
    """
    inverse, true_depth, has_truth = _check_maps(inverse_depth, truth)
    sigma = check_unmasked(deviation, "deviation", np.float64)
    if sigma.shape != has_truth.shape:
        raise InputError(
            f"deviation is {sigma.shape} and inverse_depth is {has_truth.shape}: expected the same "
            "shape"
        )
    inverse, sigma, true_depth = inverse[has_truth], sigma[has_truth], true_depth[has_truth]
    has_deviation = _has_estimate(inverse) & np.isfinite(sigma)
    relative_deviation, error = (
        np.full(len(true_depth), np.inf),
        np.full(len(true_depth), MAX_ERROR),
    )
    relative_deviation[has_deviation] = sigma[has_deviation] / inverse[has_deviation]
    has_estimate = _has_estimate(inverse)
    error[has_estimate] = (
        np.abs(scale / inverse[has_estimate] - true_depth[has_estimate]) / true_depth[has_estimate]
    )
    most_certain = np.argsort(relative_deviation, kind="stable")[
        : max(1, round(share * len(true_depth)))
    ]
    return float(np.minimum(error[most_certain], MAX_ERROR).mean())


def flicker(
    first: tuple[ArrayLike, ArrayLike],
    second: tuple[ArrayLike, ArrayLike],
    motion: ArrayLike,
    *,
    focal: float,
    center: tuple[float, float],
    scale: float = 1.0,
) -> float | None:
    """Return the mean change of the relative inverse depth r between two frames.

    r is the estimated inverse depth times the true depth, 1 for a correct estimate, so that the
    true change of depth does not count.

    Parameters
    ----------
    first, second : (array_like, array_like), each of shape (H, W)
        Estimated inverse depth and true depth of two frames.
    motion : array_like, shape (4, 4)
        True motion from the axes of the first camera to the axes of the second, in the unit of the
        true depth.
    focal : float
        Focal length, px.
    center : (float, float)
        Principal point (cx, cy), px.
    scale : float, default 1
        Factor of the estimated depth before comparing.

    Returns
    -------
    float or None
        Mean of |r₁ - r₀| over the pixels that have an estimate in both frames and whose point is
        visible in both: projected, its depth differs by at most 2 % from the true depth of the
        second frame. None if there is no such pixel.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or a truth is unknown everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import flicker
    >>> truth = np.full((12, 16), 2.0)
    >>> first, second = (0.5 * np.ones((12, 16)), truth), (0.55 * np.ones((12, 16)), truth)
    >>> motion = np.eye(4)  # the camera does not move
    >>> round(flicker(first, second, motion, focal=16.0, center=(7.5, 5.5)), 6)
    0.1
    """
    (inverse0, true_depth0, known0), (inverse1, true_depth1, known1) = (
        _check_maps(*first),
        _check_maps(*second),
    )
    if known0.shape != known1.shape:
        raise InputError(
            f"the first frame is {known0.shape} and the second is {known1.shape}: expected the "
            "same size"
        )
    rows, columns = np.nonzero(known0 & _has_estimate(inverse0))
    z = true_depth0[rows, columns]
    rays = np.stack([(columns - center[0]) / focal, (rows - center[1]) / focal, np.ones(len(z))])
    matrix = np.asarray(motion, np.float64)
    points = matrix[:3, :3] @ (rays * z) + matrix[:3, 3:]
    is_in_front = points[2] > 0
    rows, columns, points = rows[is_in_front], columns[is_in_front], points[:, is_in_front]
    x = np.rint(focal * points[0] / points[2] + center[0])
    y = np.rint(focal * points[1] / points[2] + center[1])
    height, width = known1.shape
    is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    rows, columns, depth = rows[is_inside], columns[is_inside], points[2, is_inside]
    target = y[is_inside].astype(np.intp), x[is_inside].astype(np.intp)
    is_same = known1[target] & _has_estimate(inverse1[target])
    is_same &= (
        np.abs(np.where(is_same, true_depth1[target], np.inf) - depth)
        <= MAX_DEPTH_DIFFERENCE * depth
    )
    if not is_same.any():
        return None
    ratio0 = (
        inverse0[rows[is_same], columns[is_same]] * true_depth0[rows[is_same], columns[is_same]]
    )
    ratio1 = inverse1[target][is_same] * true_depth1[target][is_same]
    return float(np.abs(ratio1 - ratio0).mean() / scale)


def depth_ratios(inverse_depth: ArrayLike, truth: ArrayLike) -> NDArray[np.float64]:
    """Return the ratios d* / d, (K,), of the pixels with known truth and an estimate."""
    inverse, true_depth, has_truth = _check_maps(inverse_depth, truth)
    is_compared = has_truth & _has_estimate(inverse)
    return np.asarray(true_depth[is_compared] * inverse[is_compared])


def estimated_share(inverse_depth: ArrayLike, truth: ArrayLike) -> float:
    """Return the share of the pixels with known truth that have an estimate."""
    inverse, _, has_truth = _check_maps(inverse_depth, truth)
    return float(_has_estimate(inverse[has_truth]).mean())


def _check_maps(inverse_depth: ArrayLike, truth: ArrayLike) -> tuple[NDArray, NDArray, NDArray]:
    """Return inverse depth and truth as float64, and where the truth is known."""
    inverse = check_unmasked(inverse_depth, "inverse_depth", np.float64)
    true_depth = check_unmasked(truth, "truth", np.float64)
    if inverse.shape != true_depth.shape or true_depth.ndim != 2:
        raise InputError(
            f"inverse_depth is {inverse.shape} and truth is {true_depth.shape}: expected the same "
            "shape, (H, W)"
        )
    has_truth = is_known(true_depth) & (true_depth > 0)
    if not has_truth.any():
        raise InputError(f"no pixel of the {true_depth.shape} truth is known and positive")
    return inverse, true_depth, has_truth


def _has_estimate(inverse: NDArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(inverse) & (inverse > 0))


_BIN_WIDTH = 1e-4  # natural logarithm
_MAX_LOG = 70.0  # natural logarithm of the largest value, and of 1 / the smallest


class LogMedian:
    """The median of positive values, within 0.01 %, without storing them.

    Values are counted in bins of their logarithm: memory does not grow with their number.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(round(2 * _MAX_LOG / _BIN_WIDTH), np.int64)

    def add(self, values: NDArray[np.float64]) -> None:
        """Count positive values, of any shape."""
        bins = ((np.log(values).ravel() + _MAX_LOG) / _BIN_WIDTH).astype(np.int64)
        np.add.at(self._counts, bins.clip(0, len(self._counts) - 1), 1)

    def median(self) -> float | None:
        """Return the median; None without values."""
        count = int(self._counts.sum())
        if not count:
            return None
        cumulative = np.cumsum(self._counts)
        lower_bin, upper_bin = np.searchsorted(cumulative, [(count + 1) // 2, count // 2 + 1])
        return float(np.exp(((lower_bin + upper_bin) / 2 + 0.5) * _BIN_WIDTH - _MAX_LOG))
