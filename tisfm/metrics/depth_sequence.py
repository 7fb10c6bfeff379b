"""Errors of the depth of single frames of a sequence, with one scale for all frames."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.metrics.valid_pixels import is_known

# Definitions of these measures, set by hand:
CERTAIN_SHARE = 0.4  # share of the pixels, those of the smallest relative deviation
MAX_ERROR = 3.0  # relative error to which the error of a pixel is limited
MAX_DEPTH_DIFFERENCE = 0.02  # relative difference of two depths up to which they count as one point
MIN_DEPTH_RATIO = 0.1  # of the smallest true depth: lower limit of an estimate
MAX_DEPTH_RATIO = 10.0  # of the largest true depth: upper limit of an estimate


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
    inverse, true, known = _maps(inverse_depth, truth)
    inverse, true = inverse[known], true[known]
    valid = _valid(inverse)
    if not valid.any():
        return 1.0
    farthest = MAX_DEPTH_RATIO * true.max()
    depth = np.full(len(true), farthest)
    depth[valid] = scale / inverse[valid]
    depth = depth.clip(MIN_DEPTH_RATIO * true.min(), farthest)
    return float((np.abs(depth - true) / true).mean())


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
        Share of the pixels with known truth that counts. The error of a pixel is limited to 3; a
        pixel without an estimate has the error 3.

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
    >>> deviation = np.array([[0.01, 0.01], [0.2, 0.2]])  # and says so
    >>> certain_error(inverse_depth, deviation, truth, share=0.5)
    0.0
    """
    inverse, true, known = _maps(inverse_depth, truth)
    sigma = check_unmasked(deviation, "deviation", np.float64)
    if sigma.shape != known.shape:
        raise InputError(
            f"deviation is {sigma.shape} and inverse_depth is {known.shape}: expected the same "
            "shape"
        )
    inverse, sigma, true = inverse[known], sigma[known], true[known]
    valid = _valid(inverse) & np.isfinite(sigma)
    relative, error = np.full(len(true), np.inf), np.full(len(true), MAX_ERROR)
    relative[valid] = sigma[valid] / inverse[valid]
    positive = _valid(inverse)
    error[positive] = np.abs(scale / inverse[positive] - true[positive]) / true[positive]
    order = np.argsort(relative, kind="stable")[: max(1, round(share * len(true)))]
    return float(np.minimum(error[order], MAX_ERROR).mean())


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
        True motion from the axes of the first camera to those of the second, in the unit of the
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
    >>> same, brighter = (0.5 * np.ones((12, 16)), truth), (0.55 * np.ones((12, 16)), truth)
    >>> at_rest = np.eye(4)
    >>> round(flicker(same, brighter, at_rest, focal=16.0, center=(7.5, 5.5)), 6)
    0.1
    """
    (inverse0, true0, known0), (inverse1, true1, known1) = _maps(*first), _maps(*second)
    if known0.shape != known1.shape:
        raise InputError(
            f"the first frame is {known0.shape} and the second is {known1.shape}: expected the "
            "same size"
        )
    rows, columns = np.nonzero(known0 & _valid(inverse0))
    z = true0[rows, columns]
    rays = np.stack([(columns - center[0]) / focal, (rows - center[1]) / focal, np.ones(len(z))])
    matrix = np.asarray(motion, np.float64)
    points = matrix[:3, :3] @ (rays * z) + matrix[:3, 3:]
    ahead = points[2] > 0
    rows, columns, points = rows[ahead], columns[ahead], points[:, ahead]
    x = np.rint(focal * points[0] / points[2] + center[0])
    y = np.rint(focal * points[1] / points[2] + center[1])
    height, width = known1.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    rows, columns, depth = rows[inside], columns[inside], points[2, inside]
    there = y[inside].astype(np.intp), x[inside].astype(np.intp)
    same = known1[there] & _valid(inverse1[there])
    same &= np.abs(np.where(same, true1[there], np.inf) - depth) <= MAX_DEPTH_DIFFERENCE * depth
    if not same.any():
        return None
    before = inverse0[rows[same], columns[same]] * true0[rows[same], columns[same]]
    after = inverse1[there][same] * true1[there][same]
    return float(np.abs(after - before).mean() / scale)


def depth_ratios(inverse_depth: ArrayLike, truth: ArrayLike) -> NDArray[np.float64]:
    """Return the ratios d* / d, (K,), of the pixels with known truth and an estimate."""
    inverse, true, known = _maps(inverse_depth, truth)
    counted = known & _valid(inverse)
    return np.asarray(true[counted] * inverse[counted])


def known_share(inverse_depth: ArrayLike, truth: ArrayLike) -> float:
    """Return the share of the pixels with known truth that have an estimate."""
    inverse, _, known = _maps(inverse_depth, truth)
    return float(_valid(inverse[known]).mean())


def _maps(inverse_depth: ArrayLike, truth: ArrayLike) -> tuple[NDArray, NDArray, NDArray]:
    """Return inverse depth and truth as float64, and where the truth is known."""
    inverse = check_unmasked(inverse_depth, "inverse_depth", np.float64)
    true = check_unmasked(truth, "truth", np.float64)
    if inverse.shape != true.shape or true.ndim != 2:
        raise InputError(
            f"inverse_depth is {inverse.shape} and truth is {true.shape}: expected the same shape, "
            "(H, W)"
        )
    known = is_known(true) & (true > 0)
    if not known.any():
        raise InputError(f"no pixel of the {true.shape} truth is known and positive")
    return inverse, true, known


def _valid(inverse: NDArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(inverse) & (inverse > 0))


_BIN_WIDTH = 1e-4  # of the natural logarithm
_MAX_LOG = 70.0  # of the natural logarithm, ±; values beyond count as the bound


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
        total = int(self._counts.sum())
        if not total:
            return None
        cumulative = np.cumsum(self._counts)
        low, high = np.searchsorted(cumulative, [(total + 1) // 2, total // 2 + 1])
        return float(np.exp(((low + high) / 2 + 0.5) * _BIN_WIDTH - _MAX_LOG))
