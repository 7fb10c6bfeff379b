"""One range of depth and of motion for a whole result, from a few of its frames."""

from collections.abc import Sequence

import numpy as np

from tisfm.results.frame import ViewFrame
from tisfm.results.frame_cache import FrameCache
from tisfm.show import inverse_depth_limit, usual_length
from tisfm.view.colors import Ranges


def ranges_of(frames: Sequence[ViewFrame], *, with_flow: bool = True) -> Ranges:
    """Return ranges that suit frames; 1 for what none of them has, or is not looked at."""
    depths = [inverse_depth_limit(frame.inverse_depth) / frame.scale for frame in frames]
    flows = [frame.flow for frame in frames] if with_flow else []
    lengths = [usual_length(flow) for flow in flows if flow is not None]
    return Ranges(inverse_depth=_middle(depths), flow=_middle(lengths))


def differ(one: Ranges, other: Ranges, factor: float) -> bool:
    """Return whether a range is more than so many times as large, or as small, as another."""
    pairs = (one.inverse_depth, other.inverse_depth), (one.flow, other.flow)
    return any(max(pair) > factor * min(pair) for pair in pairs)


def sampled(cache: FrameCache, count: int, samples: int = 3) -> list[ViewFrame]:
    """Return a few frames of so many that can be read, spread over all of them."""
    found = []
    for number in dict.fromkeys(int(k) for k in np.linspace(0, count - 1, samples)):
        try:
            found.append(cache[number])
        except (OSError, ValueError):
            continue
    return found


def _middle(values: list[float]) -> float:
    """Return the median of those above 0; 1 if there are none."""
    known = [value for value in values if value > 0]
    return float(np.median(known)) if known else 1.0
