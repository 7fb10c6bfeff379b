"""Times of frames: checks that they increase, and association of two lists of times."""

from collections.abc import Sequence
from itertools import pairwise
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.trajectory.poses import check_times


def are_increasing(times: Sequence[float | None]) -> bool:
    """Return whether all times are known and finite, and increase."""
    return _find_fault(times) == ""


def times_or_numbers(times: Sequence[float | None]) -> NDArray[np.float64]:
    """Return times, (N,) float64, s, if they increase, else the numbers 0, 1, …, N − 1."""
    if are_increasing(times):
        return np.array(times, np.float64)
    return np.arange(len(times), dtype=np.float64)


def times_note(
    times: Sequence[float | None],  # times of all frames, s
) -> str:  # "" if the times increase, or no frame has a time
    """Return why a path uses the numbers of frames instead of times."""
    fault = _find_fault(times)
    if not fault or all(time is None for time in times):
        return ""
    return f"{fault}: paths use the numbers of frames instead of times"


def _find_fault(times: Sequence[float | None]) -> str:
    """Return why times cannot be the times of a path; "" if they can."""
    for number, time in enumerate(times):
        if time is None or not isfinite(time):
            return f"frame {number} has no time"
    for number, (time0, time1) in enumerate(pairwise(times), 1):
        if fault := time_fault(time0, time1, f"frame {number - 1}", f"frame {number}"):
            return fault
    return ""


def time_fault(
    # time0, time1: times of the frames, s
    time0: float | None,
    time1: float | None,
    # name0, name1: names of the frames in the text
    name0: str,
    name1: str,
) -> str:
    """Return why the times of two consecutive frames cannot be used; "" if they can."""
    if time0 is None and time1 is None:
        return ""
    if time0 is None or time1 is None:
        return f"{name0 if time0 is None else name1} has no time"
    if time1 > time0:
        return ""
    if time1 == time0:
        return f"the times of frames repeat: {name0} and {name1} are both at {time1:.9g} s"
    return f"the times of frames go back: {name0} is at {time0:.9g} s, {name1} at {time1:.9g} s"


MAX_TIME_DIFFERENCE = 0.02
"""Largest difference of two associated times, s, as in the TUM RGB-D benchmark."""


def associate(
    times: ArrayLike, others: ArrayLike, *, farthest: float = MAX_TIME_DIFFERENCE
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair the times of two lists that are mutual nearest neighbours.

    Parameters
    ----------
    times, others : array_like, shapes (N,) and (M,)
        Times, s, increasing.
    farthest : float, default 0.02
        Largest difference of the two times of a pair, s.

    Returns
    -------
    (K,) int ndarray, (K,) int ndarray
        Indices of the pairs in `times` and in `others`, both increasing. No index occurs twice.

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
    checked_times = check_times(times, len(np.atleast_1d(times)))
    checked_others = check_times(others, len(np.atleast_1d(others)))
    if not len(checked_times) or not len(checked_others):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    nearest_other, nearest_time = (
        _nearest_indices(checked_times, checked_others),
        _nearest_indices(checked_others, checked_times),
    )
    is_mutual = nearest_time[nearest_other] == np.arange(len(checked_times))
    is_near = np.abs(checked_times - checked_others[nearest_other]) <= farthest
    matches = np.flatnonzero(is_mutual & is_near)
    return matches, nearest_other[matches]


def _nearest_indices(times: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the index in `others` nearest to each time; of two equally near times the earlier."""
    later = np.searchsorted(others, times).clip(1, len(others) - 1) if len(others) > 1 else None
    if later is None:
        return np.zeros(len(times), np.intp)
    return np.asarray(
        np.where(
            times - others[later - 1] <= others[later] - times,
            later - 1,
            later,
        )
    )
