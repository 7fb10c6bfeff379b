"""Tracks of points of unknown depth, from frame to frame along the image motion."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from tisfm.exports.guided_matching import are_reliable
from tisfm.exports.track_frames import PieceFrames, SeenPoints
from tisfm.exports.track_triangulation import consistent_points
from tisfm.reconstruction.frames.frame_flow import TRACKING_SETTINGS
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks

MAX_LENGTH = 48  # frames; a longer track continues as another one; set by hand
RELATIVE_STD = 1.0  # of the initial depth: so large that it hardly restrains a point


@dataclass
class _Group:
    """Tracks that begin in one frame, or continue there as new tracks."""

    tracks: np.ndarray  # (N,) int64, ascending
    frames: list[int] = field(default_factory=list)
    # of every frame: (N, 2), NaN for a lost point
    image_points: list[np.ndarray] = field(default_factory=list)

    def add(self, frame: int, seen: Observations) -> np.ndarray:
        """Add the positions of tracks in a frame; return which of `seen` belong to the group."""
        own = np.isin(seen.tracks, self.tracks)
        image_points = np.full((len(self.tracks), 2), np.nan)
        image_points[np.searchsorted(self.tracks, seen.tracks[own])] = seen.points[own]
        if own.any():
            self.frames.append(frame)
            self.image_points.append(image_points)
        return own


def tracks_along_flow(
    frames: PieceFrames,
    # number of cells along the longer side; a new point begins in each cell without a point
    cells: int,
    # called with the number of finished frames and of all frames
    progress: Callable[[int, int], None],
) -> list[SeenPoints]:
    """Return points with parallax whose observations follow the image motion."""
    points = []
    for group in _groups(frames, cells, progress):
        points += _points_of(frames, group)
    return points


def _groups(
    frames: PieceFrames, cells: int, progress: Callable[[int, int], None]
) -> Iterator[_Group]:
    """Track points through all frames; yield groups of tracks when they end."""
    active: list[_Group] = []
    for count, (frame, seen) in enumerate(_tracked(frames, cells), start=1):
        new = np.ones(len(seen.tracks), bool)
        continued = []
        for group in active:
            own = group.add(frame, seen)
            if own.any() and len(group.frames) < MAX_LENGTH:
                continued.append(group)
                new &= ~own
            else:
                yield group
        if new.any():
            group = _Group(tracks=seen.tracks[new])
            group.add(frame, seen)
            continued.append(group)
        active = continued
        progress(count, len(frames.numbers))
    yield from active


def _tracked(frames: PieceFrames, cells: int) -> Iterator[tuple[int, Observations]]:
    """Yield frames and their tracks; a track ends where the images no longer look alike."""
    tracker = Tracker(frames.result.camera, TRACKING_SETTINGS, cells)
    before, lost = None, np.empty(0, np.int64)
    for frame, grey in zip(frames.numbers, map(frames.grey, frames.numbers), strict=True):
        seen = tracker.track(grey, ~frames.usable(frame))
        if before is not None:
            earlier, before_seen = before
            old, now = before_seen.shared(seen)
            reliable = are_reliable(earlier, grey, before_seen.points[old], seen.points[now])
            lost = np.union1d(np.intersect1d(lost, seen.tracks), seen.tracks[now[~reliable]])
        before = grey, seen
        left = ~np.isin(seen.tracks, lost)
        yield frame, Observations(points=seen.points[left], tracks=seen.tracks[left])


def _points_of(frames: PieceFrames, group: _Group) -> list[SeenPoints]:
    """Return the points on which the tracks of a group agree."""
    if len(group.frames) < frames.min_observations:
        return []
    image_points = np.stack(group.image_points, axis=1)
    seen = [
        Observations(points=there[known], tracks=group.tracks[known])
        for there in group.image_points
        for known in [np.isfinite(there[:, 0])]
    ]
    poses = [frames.pose(frame) for frame in group.frames]
    result = frames.result
    matrices = {k: pose.matrix for k, pose in enumerate(poses)}
    initial = triangulate_tracks(seen, matrices, result.camera, result.shape)
    before = (initial.positions - poses[0].matrix[:3, 3]) @ poses[0].matrix[:3, 2] > 0
    initial = initial.among(initial.tracks[before])
    if not len(initial):
        return []
    image_points = image_points[np.searchsorted(group.tracks, initial.tracks)]
    std = np.full(len(initial), RELATIVE_STD)
    _, image_points, points = consistent_points(
        image_points, poses, result.shape, initial.positions, std, frames.min_observations
    )
    return [
        SeenPoints(
            frames=group.frames,
            image_points=image_points,
            positions=points.positions,
            residual=points.residual,
            colors=frames.colors(group.frames[0], image_points[:, 0]),
        )
    ]
