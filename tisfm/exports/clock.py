"""Times of frames, and how many there are in a second."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.trajectory.times import are_increasing, times_or_numbers

FRAME_RATE = 25.0  # 1/s, where nothing says otherwise
_SLOWEST, _FASTEST = 0.01, 1000.0


def frame_times(
    times: Sequence[float | None], frames_per_second: float | None = None
) -> NDArray[np.float64]:
    """Return the times of frames, s, or their numbers where those are not known.

    Parameters
    ----------
    times : sequence of float or None
        Of all frames of a sequence.
    frames_per_second : float, optional
        Frames are then taken to be as far apart, from 0 on, whatever `times` say.

    Raises
    ------
    ValueError
        If `frames_per_second` is none.
    """
    if frames_per_second is not None:
        return np.arange(len(times)) / check_rate(frames_per_second)
    return times_or_numbers(times)


def frame_rate(
    times: Sequence[float | None], frames: Sequence[int], frames_per_second: float | None = None
) -> float:
    """Return how many of the frames there are in a second.

    By default that is one over the median time from one to the next, or 25 where times are not
    known.

    Raises
    ------
    ValueError
        If `frames_per_second` is none.
    """
    if frames_per_second is not None:
        return check_rate(frames_per_second)
    known = [times[frame] for frame in frames]
    if len(known) < 2 or not are_increasing(known):
        return FRAME_RATE
    apart = float(np.median(np.diff(np.array(known, float))))
    return float(np.clip(1 / apart, _SLOWEST, _FASTEST))


def check_rate(frames_per_second: float) -> float:
    """Return a frame rate, or raise ValueError if it is none."""
    if not _SLOWEST <= frames_per_second <= _FASTEST:
        raise InputError(
            f"frames_per_second is {frames_per_second}: expected {_SLOWEST:g} to {_FASTEST:g}"
        )
    return float(frames_per_second)
