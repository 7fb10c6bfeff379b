"""One range of colours for all pictures of a sequence, from some of its values."""

from collections.abc import Sequence

import numpy as np

from tisfm.exports.result_frames import ResultFrames
from tisfm.show import flow_radius
from tisfm.show.palette import DEPTH_PERCENTILE, FLOW_PERCENTILE

FRAMES, VALUES = 48, 20_000  # frames that are looked at, and values of each, about


def some_of(frames: Sequence[int], count: int = FRAMES) -> list[int]:
    """Return so many of the frames at most, evenly."""
    if len(frames) <= count:
        return list(frames)
    return [frames[k] for k in np.linspace(0, len(frames) - 1, count).round().astype(int)]


def inverse_depth_ranges(
    frames: ResultFrames, chosen: Sequence[int], percentile: float = DEPTH_PERCENTILE
) -> dict[int, float]:
    """Return the inverse depth that so many values stay below, for each group with one scale.

    It is in multiples of what `ResultFrames.scale` returns. By default it is what is shown as
    nearest. 0 where there is none.
    """
    groups: dict[int, list[int]] = {}
    for frame in chosen:
        groups.setdefault(frames.scale(frame)[0], []).append(frame)
    ranges = {}
    for group, members in groups.items():
        found = [_positive(frames, frame) for frame in some_of(members)]
        values = np.concatenate(found)
        ranges[group] = float(np.percentile(values, percentile)) if len(values) else 0.0
    return ranges


def speed_range(frames: ResultFrames, chosen: Sequence[int]) -> float:
    """Return the length of image motion, px, that nearly all of what is looked at stays below."""
    found = []
    for frame in some_of(chosen):
        radius = flow_radius(thinned(frames.flow(frame))).ravel()
        found.append(radius[np.isfinite(radius)])
    values = np.concatenate(found)
    return float(np.percentile(values, FLOW_PERCENTILE)) if len(values) else 0.0


def thinned(values: np.ndarray) -> np.ndarray:
    """Return about `VALUES` of the pixels of a map, (h, w) or (h, w, 2), evenly."""
    step = max(1, int(np.sqrt(values.shape[0] * values.shape[1] / VALUES)))
    return values[step // 2 :: step, step // 2 :: step]


def _positive(frames: ResultFrames, frame: int) -> np.ndarray:
    values = thinned(frames.inverse_depth(frame)).ravel() / frames.scale(frame)[1]
    return np.asarray(values[np.isfinite(values) & (values > 0)])
