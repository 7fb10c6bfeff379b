"""Tracks of points whose depth is not known: carried from frame to frame along the image motion."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from tisfm.exports.guided_matching import are_held
from tisfm.exports.track_frames import PieceFrames, SeenPoints
from tisfm.exports.track_triangulation import consistent
from tisfm.reconstruction.frames.frame_flow import TRACKING_SETTINGS
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks

LONGEST = 48  # frames of a track; a longer one goes on as another
RELATIVE_STD = 1.0  # of the depth that points begin at: it hardly holds them


@dataclass
class _Group:
    """Tracks that began, or went on as others, in one frame."""

    tracks: np.ndarray  # (N,) int64, ascending
    frames: list[int] = field(default_factory=list)
    places: list[np.ndarray] = field(default_factory=list)  # of every frame: (N, 2), NaN if lost

    def take(self, frame: int, seen: Observations) -> np.ndarray:
        """Take the places of tracks in a frame, and return which of `seen` are of the group."""
        mine = np.isin(seen.tracks, self.tracks)
        places = np.full((len(self.tracks), 2), np.nan)
        places[np.searchsorted(self.tracks, seen.tracks[mine])] = seen.points[mine]
        if mine.any():
            self.frames.append(frame)
            self.places.append(places)
        return mine


def along_motion(
    frames: PieceFrames, cells: int, progress: Callable[[int, int], None]
) -> list[SeenPoints]:
    """Return points that are seen along the motion of the image, and that show parallax.

    Parameters
    ----------
    frames : PieceFrames
    cells : int
        Along the longer side: a point is begun in every cell that has none.
    progress : callable
        Told the number of frames that are done, and of all.
    """
    found = []
    for group in _groups(frames, cells, progress):
        found += _located(frames, group)
    return found


def _groups(
    frames: PieceFrames, cells: int, progress: Callable[[int, int], None]
) -> Iterator[_Group]:
    """Carry points through all frames, and give those that end."""
    going: list[_Group] = []
    for count, (frame, seen) in enumerate(_carried(frames, cells), start=1):
        new = np.ones(len(seen.tracks), bool)
        still = []
        for group in going:
            mine = group.take(frame, seen)
            if mine.any() and len(group.frames) < LONGEST:
                still.append(group)
                new &= ~mine
            else:
                yield group
        if new.any():
            group = _Group(tracks=seen.tracks[new])
            group.take(frame, seen)
            still.append(group)
        going = still
        progress(count, len(frames.numbers))
    yield from going


def _carried(frames: PieceFrames, cells: int) -> Iterator[tuple[int, Observations]]:
    """Give frames and the tracks in them, each up to where something else is taken for it."""
    tracker = Tracker(frames.result.camera, TRACKING_SETTINGS, cells)
    before, lost = None, np.empty(0, np.int64)
    for frame, grey in zip(frames.numbers, map(frames.grey, frames.numbers), strict=True):
        seen = tracker.track(grey, ~frames.usable(frame))
        if before is not None:
            earlier, was = before
            old, now = was.shared(seen)
            held = are_held(earlier, grey, was.points[old], seen.points[now])
            lost = np.union1d(np.intersect1d(lost, seen.tracks), seen.tracks[now[~held]])
        before = grey, seen
        left = ~np.isin(seen.tracks, lost)
        yield frame, Observations(points=seen.points[left], tracks=seen.tracks[left])


def _located(frames: PieceFrames, group: _Group) -> list[SeenPoints]:
    """Return the points of a group of tracks that agree on them."""
    if len(group.frames) < frames.fewest:
        return []
    places = np.stack(group.places, axis=1)
    seen = [
        Observations(points=there[known], tracks=group.tracks[known])
        for there in group.places
        for known in [np.isfinite(there[:, 0])]
    ]
    poses = [frames.pose(frame) for frame in group.frames]
    result = frames.result
    matrices = {k: pose.matrix for k, pose in enumerate(poses)}
    begun = triangulate_tracks(seen, matrices, result.camera, result.shape)
    before = (begun.positions - poses[0].matrix[:3, 3]) @ poses[0].matrix[:3, 2] > 0
    begun = begun.among(begun.tracks[before])
    if not len(begun):
        return []
    places = places[np.searchsorted(group.tracks, begun.tracks)]
    std = np.full(len(begun), RELATIVE_STD)
    _, places, points = consistent(places, poses, result.shape, begun.positions, std, frames.fewest)
    return [
        SeenPoints(
            frames=group.frames,
            places=places,
            positions=points.positions,
            residual=points.residual,
            colors=frames.colors(group.frames[0], places[:, 0]),
        )
    ]
