"""Where the scales of legends have ticks, and how their numbers are written."""

import math
import sys
from collections.abc import Sequence

import numpy as np

_LEAST_USUAL, _MOST_USUAL = 1e-3, 1e6  # numbers that are read without an exponent
_MOST_DOUBLINGS = 12
_LEAST_SHARE = 0.04  # of a scale of depth: what is farther lies at its end


def depth_ticks(limit: float) -> list[tuple[float, str]]:
    """Return ticks of a scale that is linear in inverse depth: its ends, and round depths.

    Parameters
    ----------
    limit : float
        Inverse depth at the near end, beyond which all looks like it; 0 if there is no depth.

    Returns
    -------
    list of (float, str)
        Shares of the scale, rising from 0, infinitely far, to 1, and the depths there: 1, 2 and 5
        times powers of ten but for the near end.
    """
    far = (0.0, "∞")
    if limit == 0:
        return [far, (1.0, "none")]
    nearest = 1 / limit
    ticks = [(1.0, f"≤ {as_read(nearest)}")]
    if math.isfinite(nearest):
        power = math.floor(math.log10(nearest))
        for depth in (float(f"{digit}e{power + k}") for k in range(3) for digit in (1, 2, 5)):
            share = 1 / (depth * limit) if depth > nearest * (1 + 1e-9) else 1.0
            if _LEAST_SHARE <= share < 1:
                ticks.append((share, as_read(depth)))
    return [far, *reversed(ticks)]


def doublings(limits: tuple[float, float], unit: str) -> list[tuple[float, str]]:
    """Return ticks of a logarithmic scale: its ends, beyond which all looks like them, and doubles.

    Parameters
    ----------
    limits : (float, float)
        Values at the two ends.
    unit : str
        Written after each.

    Returns
    -------
    list of (float, str)
        Shares of the scale, rising from 0 to 1, and what they stand for. Where there would be more
        than a dozen doublings between the ends it is every second one, and so on.
    """
    # Smaller ones may count as 0, as in a process in which Taichi runs.
    low, high = max(limits[0], sys.float_info.min), min(limits[1], sys.float_info.max)
    span = math.log2(high) - math.log2(low)
    inside = math.ceil(span - 1e-9)
    ticks = [
        (k / span, f"{math.ldexp(low, k):.3g} {unit}")
        for k in range(1, inside)
        if k % (1 + inside // (_MOST_DOUBLINGS + 1)) == 0
    ]
    return [(0.0, f"≤ {low:.3g} {unit}"), *ticks, (1.0, f"≥ {high:.3g} {unit}")]


def as_read(value: float) -> str:
    """Return a number with three digits, without an exponent unless it is very large or small."""
    rounded = float(f"{value:.3g}")
    is_usual = _LEAST_USUAL <= abs(rounded) < _MOST_USUAL
    return np.format_float_positional(rounded, trim="-") if is_usual else f"{rounded:.3g}"


def with_room(ticks: Sequence[tuple[float, str]], needed: float) -> list[tuple[float, str]]:
    """Return the first and last tick, and of the others those that are so far from their like."""
    first, *between, last = ticks
    kept = [first]
    for tick in between:
        if tick[0] - kept[-1][0] >= needed and last[0] - tick[0] >= needed:
            kept.append(tick)
    return [*kept, last]
