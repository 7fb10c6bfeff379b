"""Common ranges of colours for all pictures of a sequence, from a sample of its values."""

from collections.abc import Sequence

import numpy as np

from tisfm.results.result_frames import ResultFrames
from tisfm.show import flow_radius
from tisfm.show.palette import DEPTH_PERCENTILE, FLOW_PERCENTILE

# Set by hand.
SAMPLED_FRAMES = 48
SAMPLED_PIXELS = 20_000  # about, of each frame


def some_of(frames: Sequence[int], count: int = SAMPLED_FRAMES) -> list[int]:
    """Return at most `count` of the frames, evenly spread."""
    if len(frames) <= count:
        return list(frames)
    return [frames[k] for k in np.linspace(0, len(frames) - 1, count).round().astype(int)]


def inverse_depth_ranges(
    frames: ResultFrames, chosen: Sequence[int], percentile: float = DEPTH_PERCENTILE
) -> dict[int, float]:
    """Return a percentile of inverse depth for each group of frames with one scale.

    It is in multiples of the scale of `ResultFrames.scale`; 0 for a group without depth. The
    default percentile is that of the nearest colour.
    """
    groups: dict[int, list[int]] = {}
    for frame in chosen:
        groups.setdefault(frames.scale(frame)[0], []).append(frame)
    ranges = {}
    for group, members in groups.items():
        samples = [_positive(frames, frame) for frame in some_of(members)]
        values = np.concatenate(samples)
        ranges[group] = float(np.percentile(values, percentile)) if len(values) else 0.0
    return ranges


def speed_range(frames: ResultFrames, chosen: Sequence[int]) -> float:
    """Return the length of image motion, px, that 98 % of the sample stay below."""
    samples = []
    for frame in some_of(chosen):
        radius = flow_radius(thinned(frames.flow(frame))).ravel()
        samples.append(radius[np.isfinite(radius)])
    values = np.concatenate(samples)
    return float(np.percentile(values, FLOW_PERCENTILE)) if len(values) else 0.0


def thinned(values: np.ndarray) -> np.ndarray:
    """Return about `SAMPLED_PIXELS` pixels of a map on a regular grid, (h, w) or (h, w, 2)."""
    step = max(1, int(np.sqrt(values.shape[0] * values.shape[1] / SAMPLED_PIXELS)))
    return values[step // 2 :: step, step // 2 :: step]


def _positive(frames: ResultFrames, frame: int) -> np.ndarray:
    values = thinned(frames.inverse_depth(frame)).ravel() / frames.scale(frame)[1]
    return np.asarray(values[np.isfinite(values) & (values > 0)])
