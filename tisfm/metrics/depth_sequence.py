"""Errors of the depth of one frame of a sequence, in a scale that all its frames share."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import unmasked
from tisfm.errors import InputError
from tisfm.metrics.valid_pixels import is_known

CERTAIN = 0.4  # share of the pixels: those of the least relative deviation
WORST = 3.0  # relative error at which a pixel's is limited
SAME_SURFACE = 0.02  # relative: depths that differ by less are of one point
NEAREST, FARTHEST = 0.1, 10.0  # of the least and the greatest true depth: limits of an estimate


def limited_error(inverse_depth: ArrayLike, truth: ArrayLike, *, scale: float = 1.0) -> float:
    """Return the mean |d - d*| / d* over all pixels with known truth, none left out.

    Parameters
    ----------
    inverse_depth : array_like, shape (H, W)
        Estimate. A pixel without one, not finite and positive, is taken to be as far as the limit.
    truth : array_like, shape (H, W)
        True depth d*; unknown where it is not finite and positive.
    scale : float, default 1
        What depth, d, is multiplied by before it is limited to [0.1 min d*, 10 max d*].

    Returns
    -------
    float
        As `DepthErrors.abs_rel_all`, with a given scale; 1 where no pixel has an estimate.

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
    farthest = FARTHEST * true.max()
    depth = np.full(len(true), farthest)
    depth[valid] = scale / inverse[valid]
    depth = depth.clip(NEAREST * true.min(), farthest)
    return float((np.abs(depth - true) / true).mean())


def certain_error(
    inverse_depth: ArrayLike,
    deviation: ArrayLike,
    truth: ArrayLike,
    *,
    scale: float = 1.0,
    share: float = CERTAIN,
) -> float:
    """Return the mean |d - d*| / d* of the pixels with the least relative deviation.

    Parameters
    ----------
    inverse_depth, deviation : array_like, shape (H, W)
        Estimate and its standard deviation, in one unit.
    truth : array_like, shape (H, W)
        True depth d*; unknown where it is not finite and positive.
    scale : float, default 1
        What depth is multiplied by first.
    share : float, default 0.4
        Of the pixels with known truth, which count. The error of each is limited to 3, which those
        without an estimate have.

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
    sigma = unmasked(deviation, "deviation", np.float64)
    if sigma.shape != known.shape:
        raise InputError(
            f"deviation is {sigma.shape} and inverse_depth is {known.shape}: expected the same "
            "shape"
        )
    inverse, sigma, true = inverse[known], sigma[known], true[known]
    valid = _valid(inverse) & np.isfinite(sigma)
    relative, error = np.full(len(true), np.inf), np.full(len(true), WORST)
    relative[valid] = sigma[valid] / inverse[valid]
    positive = _valid(inverse)
    error[positive] = np.abs(scale / inverse[positive] - true[positive]) / true[positive]
    order = np.argsort(relative, kind="stable")[: max(1, round(share * len(true)))]
    return float(np.minimum(error[order], WORST).mean())


def flicker(
    first: tuple[ArrayLike, ArrayLike],
    second: tuple[ArrayLike, ArrayLike],
    motion: ArrayLike,
    *,
    focal: float,
    center: tuple[float, float],
    scale: float = 1.0,
) -> float | None:
    """Return how much relative inverse depth changes along the true flow between two frames.

    Relative inverse depth is the estimated one times the true depth, 1 where it is right: what a
    point gains or loses by coming nearer is no change.

    Parameters
    ----------
    first, second : (array_like, array_like), each of shape (H, W)
        Of two frames, the estimated inverse depth and the true depth.
    motion : array_like, shape (4, 4)
        The true one, from the axes of the first camera to those of the second, in the unit of the
        true depth.
    focal : float
        px.
    center : (float, float)
        Principal point (cx, cy), px.
    scale : float, default 1
        What estimated depth is multiplied by first.

    Returns
    -------
    float or None
        Mean of |r₁ - r₀| over the pixels whose point both frames see, by the true depths, within
        2 % of one another, and have an estimate for; None where there is none.

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
    same &= np.abs(np.where(same, true1[there], np.inf) - depth) <= SAME_SURFACE * depth
    if not same.any():
        return None
    before = inverse0[rows[same], columns[same]] * true0[rows[same], columns[same]]
    after = inverse1[there][same] * true1[there][same]
    return float(np.abs(after - before).mean() / scale)


def depth_ratios(inverse_depth: ArrayLike, truth: ArrayLike) -> NDArray[np.float64]:
    """Return d* / d, (K,), of the pixels with a known truth and an estimate."""
    inverse, true, known = _maps(inverse_depth, truth)
    counted = known & _valid(inverse)
    return np.asarray(true[counted] * inverse[counted])


def known_share(inverse_depth: ArrayLike, truth: ArrayLike) -> float:
    """Return the share of the pixels with known truth that have an estimate."""
    inverse, _, known = _maps(inverse_depth, truth)
    return float(_valid(inverse[known]).mean())


def _maps(inverse_depth: ArrayLike, truth: ArrayLike) -> tuple[NDArray, NDArray, NDArray]:
    """Return both as float64, and where the truth is known."""
    inverse = unmasked(inverse_depth, "inverse_depth", np.float64)
    true = unmasked(truth, "truth", np.float64)
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
