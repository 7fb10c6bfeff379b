"""Which times of two clocks belong together."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.trajectory.path import check_times

FARTHEST = 0.02  # s, as in the benchmark


def associate(
    times: ArrayLike, others: ArrayLike, *, farthest: float = FARTHEST
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair times that are nearest to one another.

    Parameters
    ----------
    times, others : array_like, shapes (N,) and (M,)
        s, each above the one before.
    farthest : float, default 0.02
        No pair is farther apart, s.

    Returns
    -------
    (K,) int ndarray, (K,) int ndarray
        Where the pairs are in `times` and in `others`, both in order. No time is in two.

    Raises
    ------
    ValueError
        If times do not increase.

    References
    ----------
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012,
    doi 10.1109/IROS.2012.6385773, has the same limit.

    Examples
    --------
    >>> from tisfm.trajectory import associate
    >>> first, second = associate([0.0, 0.1, 0.2], [0.101, 0.3])
    >>> first.tolist(), second.tolist()
    ([1], [0])
    """
    first = check_times(times, len(np.atleast_1d(times)))
    second = check_times(others, len(np.atleast_1d(others)))
    if not len(first) or not len(second):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    there, back = _nearest(first, second), _nearest(second, first)
    mutual = back[there] == np.arange(len(first))
    near = np.abs(first - second[there]) <= farthest
    found = np.flatnonzero(mutual & near)
    return found, there[found]


def _nearest(times: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return where in `others` the nearest one of every time is, the earlier one of two."""
    after = np.searchsorted(others, times).clip(1, len(others) - 1) if len(others) > 1 else None
    if after is None:
        return np.zeros(len(times), np.intp)
    return np.asarray(
        np.where(times - others[after - 1] <= others[after] - times, after - 1, after)
    )
