"""Pairs of frames with points that both show, from tracks and from matches of views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.rotation.settings import ROTATION
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


@dataclass(frozen=True, kw_only=True)
class FramePair:
    """Positions of points in two frames, px from the centre."""

    first: int
    second: int
    before: np.ndarray  # (N, 2) float64, in the first frame
    after: np.ndarray  # (N, 2) float64, in the second frame

    @property
    def motion(self) -> float:
        """The median distance between the two positions of a point, px."""
        return float(np.median(np.hypot(*(self.after - self.before).T)))


def find_frame_pairs(
    frames: Sequence[int],  # frames whose pairs are returned, in order
    observations: Sequence[Observations],  # tracks, by frame
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],  # by pair of view indices: (N, 2) indices
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],
) -> list[FramePair]:
    """Return all pairs with enough points."""
    known, center = set(frames), np.array(camera.center_for(*shape))
    pairs = []
    for first in frames:
        for second in (first + step for step in ROTATION.steps):
            if second not in known:
                continue
            rows, others = observations[first].common_tracks(observations[second])
            before = observations[first].points[rows]
            after = observations[second].points[others]
            pairs.append((first, second, before, after))
    for (earlier, later), indices in matches.items():
        first, second = views[earlier].frame, views[later].frame
        if first in known and second in known:
            before = views[earlier].detected[indices[:, 0]]
            pairs.append((first, second, before, views[later].detected[indices[:, 1]]))
    return [
        FramePair(
            first=first,
            second=second,
            before=_spread(before - center),
            after=_spread(after - center),
        )
        for first, second, before, after in pairs
        if len(before) >= ROTATION.min_points
    ]


def _spread(points: np.ndarray) -> np.ndarray:
    """Return at most `max_points` of the points, evenly chosen."""
    count = min(len(points), ROTATION.max_points)
    return points[np.linspace(0, len(points) - 1, count).astype(int)]
