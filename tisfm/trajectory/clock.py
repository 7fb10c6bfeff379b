"""Whether the times of frames can serve a path: known, and each after the one before."""

from collections.abc import Sequence
from itertools import pairwise
from math import isfinite

import numpy as np
from numpy.typing import NDArray


def do_rise(times: Sequence[float | None]) -> bool:
    """Return whether all times are known and finite, and each is later than the one before."""
    return _fault(times) == ""


def times_or_numbers(times: Sequence[float | None]) -> NDArray[np.float64]:
    """Return times, (N,) float64, s, if they rise; or else the numbers 0, 1, …, N − 1."""
    if do_rise(times):
        return np.array(times, np.float64)
    return np.arange(len(times), dtype=np.float64)


def times_note(times: Sequence[float | None]) -> str:
    """Return why a path uses the numbers of frames instead of times.

    Parameters
    ----------
    times : sequence of float or None
        Of all frames, s.

    Returns
    -------
    str
        "" if times rise or no frame has a time.
    """
    fault = _fault(times)
    if not fault or all(time is None for time in times):
        return ""
    return f"{fault}: paths use the numbers of frames instead of times"


def _fault(times: Sequence[float | None]) -> str:
    """Return why times cannot serve a path, "" if they can."""
    for number, time in enumerate(times):
        if time is None or not isfinite(time):
            return f"frame {number} has no time"
    for number, (before, after) in enumerate(pairwise(times), 1):
        if fault := fault_between(before, after, f"frame {number - 1}", f"frame {number}"):
            return fault
    return ""


def fault_between(before: float | None, after: float | None, first: str, second: str) -> str:
    """Return why the times of two frames cannot serve a path, "" if they can.

    Parameters
    ----------
    before, after : float or None
        When the frames were taken, s.
    first, second : str
        Names of the frames in the answer.
    """
    if before is None and after is None:
        return ""
    if before is None or after is None:
        return f"{first if before is None else second} has no time"
    if after > before:
        return ""
    if after == before:
        return f"the times of frames repeat: {first} and {second} are both at {after:.9g} s"
    return f"the times of frames go back: {first} is at {before:.9g} s, {second} at {after:.9g} s"
