"""Ticks of the scales of legends, and their labels."""

import math
import sys
from collections.abc import Sequence

import numpy as np

# Set by hand.
_MIN_PLAIN = 1e-3  # numbers from here on are written without an exponent
_MAX_PLAIN = 1e6  # numbers from here on are written with an exponent
_MAX_DOUBLINGS = 12  # ticks between both ends
_MIN_SHARE = 0.04  # position of the farthest tick on a scale of depth


def depth_ticks(
    limit: float,  # inverse depth at the near end, which nearer pixels share; 0 without depth
) -> list[tuple[float, str]]:
    """Return ticks of a scale that is linear in inverse depth: both ends, and round depths.

    Returns positions on the scale, from 0, infinitely far, to 1, and depths: 1, 2 and 5 times
    powers of ten, with room between them at the near end.
    """
    far = (0.0, "∞")
    if limit == 0:
        return [far, (1.0, "none")]
    nearest = 1 / limit
    ticks = [(1.0, f"≤ {number_text(nearest)}")]
    if math.isfinite(nearest):
        power = math.floor(math.log10(nearest))
        for depth in (float(f"{digit}e{power + k}") for k in range(3) for digit in (1, 2, 5)):
            share = 1 / (depth * limit) if depth > nearest * (1 + 1e-9) else 1.0
            if _MIN_SHARE <= share < 1:
                ticks.append((share, number_text(depth)))
    return [far, *reversed(ticks)]


def doublings(
    # values at both ends, which values beyond them share
    limits: tuple[float, float],
    unit: str,  # written after each value
) -> list[tuple[float, str]]:
    """Return ticks of a logarithmic scale: both ends, and doublings between them.

    Returns positions on the scale, from 0 to 1, and labels. With more than a dozen doublings only
    every second one is a tick, and so on.
    """
    # Denormal numbers count as 0 in a process in which Taichi runs.
    low, high = max(limits[0], sys.float_info.min), min(limits[1], sys.float_info.max)
    span = math.log2(high) - math.log2(low)
    inside = math.ceil(span - 1e-9)
    ticks = [
        (k / span, f"{math.ldexp(low, k):.3g} {unit}")
        for k in range(1, inside)
        if k % (1 + inside // (_MAX_DOUBLINGS + 1)) == 0
    ]
    return [(0.0, f"≤ {low:.3g} {unit}"), *ticks, (1.0, f"≥ {high:.3g} {unit}")]


def number_text(value: float) -> str:
    """Return a number with three digits; with an exponent only if it is very large or small."""
    rounded = float(f"{value:.3g}")
    is_plain = _MIN_PLAIN <= abs(rounded) < _MAX_PLAIN
    return np.format_float_positional(rounded, trim="-") if is_plain else f"{rounded:.3g}"


def with_room(ticks: Sequence[tuple[float, str]], distance: float) -> list[tuple[float, str]]:
    """Return the first and last tick, and others at least a distance from their neighbours."""
    first, *between, last = ticks
    chosen = [first]
    for tick in between:
        if tick[0] - chosen[-1][0] >= distance and last[0] - tick[0] >= distance:
            chosen.append(tick)
    return [*chosen, last]
