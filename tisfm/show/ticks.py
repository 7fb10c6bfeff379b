"""Ticks of the scales of legends, and their labels."""

import math
import sys
from collections.abc import Sequence

import numpy as np

# Set by hand.
_MIN_PLAIN = 1e-3  # smaller numbers are written with an exponent
_MAX_PLAIN = 1e6  # this number and larger numbers are written with an exponent
_MAX_DOUBLINGS = 12  # ticks between both ends of a logarithmic scale
_MIN_DEPTH_POSITION = 0.04  # position, from 0 to 1, of the farthest tick on a scale of depth


def depth_ticks(
    limit: float,  # inverse depth at the near end of the scale; 0 if no pixel has a depth
) -> list[tuple[float, str]]:
    """Return ticks of a scale that is linear in inverse depth: both ends, and round depths.

    Returns positions on the scale, from 0, infinitely far, to 1, and depths: 1, 2 and 5 times
    powers of ten.
    """
    far_tick = (0.0, "∞")
    if limit == 0:
        return [far_tick, (1.0, "none")]
    min_depth = 1 / limit
    ticks = [(1.0, f"≤ {format_number(min_depth)}")]
    if math.isfinite(min_depth):
        power = math.floor(math.log10(min_depth))
        for depth in (float(f"{digit}e{power + k}") for k in range(3) for digit in (1, 2, 5)):
            share = 1 / (depth * limit) if depth > min_depth * (1 + 1e-9) else 1.0
            if _MIN_DEPTH_POSITION <= share < 1:
                ticks.append((share, format_number(depth)))
    return [far_tick, *reversed(ticks)]


def doubling_ticks(
    limits: tuple[float, float],  # values at both ends of the scale
    unit: str,  # written after each value
) -> list[tuple[float, str]]:
    """Return ticks of a logarithmic scale: both ends, and doublings between them.

    Returns positions on the scale, from 0 to 1, and labels. With more than 12 doublings only
    every second doubling is a tick, with more than 25 every third, and so on.
    """
    # Denormal numbers count as 0 after Taichi has started in this process.
    low, high = max(limits[0], sys.float_info.min), min(limits[1], sys.float_info.max)
    span = math.log2(high) - math.log2(low)
    step_count = math.ceil(span - 1e-9)
    ticks = [
        (k / span, f"{math.ldexp(low, k):.3g} {unit}")
        for k in range(1, step_count)
        if k % (1 + step_count // (_MAX_DOUBLINGS + 1)) == 0
    ]
    return [(0.0, f"≤ {low:.3g} {unit}"), *ticks, (1.0, f"≥ {high:.3g} {unit}")]


def format_number(value: float) -> str:
    """Return a number with three digits; a very large or small number has an exponent."""
    rounded_value = float(f"{value:.3g}")
    is_plain = _MIN_PLAIN <= abs(rounded_value) < _MAX_PLAIN
    return (
        np.format_float_positional(rounded_value, trim="-") if is_plain else f"{rounded_value:.3g}"
    )


def select_ticks(
    ticks: Sequence[tuple[float, str]], min_distance: float
) -> list[tuple[float, str]]:
    """Return the first and the last tick, and ticks between them at a minimum distance."""
    first, *inner_ticks, last = ticks
    selected_ticks = [first]
    for tick in inner_ticks:
        if tick[0] - selected_ticks[-1][0] >= min_distance and last[0] - tick[0] >= min_distance:
            selected_ticks.append(tick)
    return [*selected_ticks, last]
