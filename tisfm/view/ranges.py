"""Common ranges of depth and motion for all frames of a result."""

from collections.abc import Sequence

import numpy as np

from tisfm.results.frame import ResultFrame
from tisfm.results.frame_cache import FrameCache
from tisfm.show import inverse_depth_limit, usual_length
from tisfm.view.colors import Ranges


def ranges_of(frames: Sequence[ResultFrame], *, with_flow: bool = True) -> Ranges:
    """Return the median ranges of frames; 1 for a quantity that no frame has."""
    depths = [inverse_depth_limit(frame.inverse_depth) / frame.scale for frame in frames]
    flows = [frame.flow for frame in frames] if with_flow else []
    lengths = [usual_length(flow) for flow in flows if flow is not None]
    return Ranges(inverse_depth=_median(depths), flow=_median(lengths))


def differ(one: Ranges, other: Ranges, factor: float) -> bool:
    """Return whether depth or motion ranges differ by more than a factor."""
    pairs = (one.inverse_depth, other.inverse_depth), (one.flow, other.flow)
    return any(max(pair) > factor * min(pair) for pair in pairs)


def sampled(cache: FrameCache, count: int, samples: int = 3) -> list[ResultFrame]:
    """Return a few readable frames, spread evenly over `count` frames."""
    frames = []
    for number in dict.fromkeys(int(k) for k in np.linspace(0, count - 1, samples)):
        try:
            frames.append(cache[number])
        except (OSError, ValueError):
            continue
    return frames


def _median(values: list[float]) -> float:
    """Return the median of the positive values; 1 without any."""
    known = [value for value in values if value > 0]
    return float(np.median(known)) if known else 1.0
