"""Points of a piece in several frames: found by depth and poses, or along the image motion."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from tisfm.exports.guided_matching import (
    are_reliable,
    measure_points,
    points_in_world,
    smooth_pixels,
)
from tisfm.exports.observations import ObservedPoints, PieceFrames, consistent_points
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS
from tisfm.reconstruction.tracks.tracker import Observations, Tracker, choose_new_points
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks

# Set by hand.
NEIGHBOUR_KEYFRAMES = 4  # to either side of a keyframe, besides the frames up to the next keyframe
MAX_FRAME_DISTANCE = 120  # frames to either side of a keyframe
DISTANT_KEYFRAMES = 4  # further keyframes that see the same points
MIN_VISIBLE_SHARE = 0.5  # share of the points of a keyframe that a distant keyframe sees
MAX_DISTANCE_RATIO = 1.6  # of two cameras from a point: beyond it, the images differ too much
SAMPLED_POINTS = 64  # points that decide which keyframes see the same points
MIN_POINTS = 150  # points in a frame other than a keyframe: with fewer, points begin there too
# distances of the frames that a frame with few points is matched with, frames to either side
NEIGHBOUR_STEPS = (1, 2, 3, 4, 6, 8, 12)
MAX_RELATIVE_STD = 0.3  # standard deviation of inverse depth, as a share, for a new point

FrameChooser = Callable[[int, np.ndarray, np.ndarray], list[int]]


class DepthTracks:
    """Finds points of keyframes, and of frames with few points, in other frames."""

    def __init__(
        self,
        frames: PieceFrames,
        # number of cells along the longer side; a new point begins in each cell without a point
        cells: int,
    ) -> None:
        self._frames, self._cells = frames, cells
        self._observed_points: dict[int, list[np.ndarray]] = {frame: [] for frame in frames.numbers}

    def find(self, progress: Callable[[int, int], None]) -> list[ObservedPoints]:
        """Return the points of all frames; `progress` receives finished frames and all frames."""
        numbers, keyframes = self._frames.numbers, self._frames.keyframes
        groups = []
        for frame in keyframes:
            groups += self._start_points(frame, self._frames_of_keyframe)
            progress(frame - numbers[0] + 1, len(numbers))
        for frame in sorted(set(numbers) - set(keyframes)):
            if sum(map(len, self._observed_points[frame])) < MIN_POINTS:
                groups += self._start_points(frame, self._neighbours)
        progress(len(numbers), len(numbers))
        return groups

    def _start_points(self, frame: int, choose_frames: FrameChooser) -> list[ObservedPoints]:
        """Begin points in free cells of a frame, and find them in other frames."""
        frames, result = self._frames, self._frames.result
        inverse_depth = result.inverse_depth(frame)
        with np.errstate(invalid="ignore", divide="ignore"):
            relative_std = result.inverse_depth_std(frame) / inverse_depth
            is_reliable = (inverse_depth > 0) & (relative_std < MAX_RELATIVE_STD)
        is_reliable &= frames.usable_pixels(frame) & smooth_pixels(inverse_depth)
        occupied_positions = np.vstack([np.empty((0, 2)), *self._observed_points[frame]])
        points = choose_new_points(
            frames.grey(frame), occupied_positions, ~is_reliable, self._cells
        )
        if not len(points):
            return []
        column, row = points.astype(np.intp).T
        inverse, std = (
            values[row, column].astype(float) for values in (inverse_depth, relative_std)
        )
        positions = points_in_world(points, inverse, frames.pose(frame), result.shape)
        observers = [
            frame,
            *(k for k in choose_frames(frame, positions, 1 / inverse) if k != frame),
        ]
        other_image_points = [
            self._measure_in(frame, k, points, inverse_depth) for k in observers[1:]
        ]
        image_points = np.stack([points, *other_image_points], axis=1)
        poses = [frames.pose(k) for k in observers]
        is_kept, image_points, estimate = consistent_points(
            image_points, poses, result.shape, positions, std, frames.min_observations
        )
        for number, observer in enumerate(observers):
            observed_points = image_points[np.isfinite(image_points[:, number, 0]), number]
            self._observed_points[observer].append(observed_points.astype(np.float32))
        group = ObservedPoints(
            frames=observers,
            image_points=image_points,
            positions=estimate.positions,
            residual=estimate.residual,
            colors=frames.colors(frame, points[is_kept]),
        )
        return [group]

    def _measure_in(
        self, frame: int, other: int, points: np.ndarray, inverse_depth: np.ndarray
    ) -> np.ndarray:
        """Return the positions of points in another frame, (N, 2); NaN if lost or moving."""
        frames = self._frames
        image_points = measure_points(
            frames.grey(frame),
            frames.grey(other),
            points,
            inverse_depth,
            frames.pose(frame),
            frames.pose(other),
        )
        indices = np.flatnonzero(np.isfinite(image_points[:, 0]))
        column, row = np.rint(image_points[indices]).astype(np.intp).T
        image_points[indices[~frames.usable_pixels(other)[row, column]]] = np.nan
        return image_points

    def _frames_of_keyframe(
        self, frame: int, positions: np.ndarray, depth: np.ndarray
    ) -> list[int]:
        """Return frames that see much of the scene of a keyframe."""
        numbers, keyframes = self._frames.numbers, self._frames.keyframes
        index = bisect_left(keyframes, frame)
        first = keyframes[index - 1] if index else numbers[0]
        last = keyframes[index + 1] if index + 1 < len(keyframes) else numbers[-1]
        begin = bisect_left(numbers, max(first, frame - MAX_FRAME_DISTANCE))
        end = bisect_right(numbers, min(last, frame + MAX_FRAME_DISTANCE))
        nearby_keyframes = keyframes[
            max(0, index - NEIGHBOUR_KEYFRAMES) : index + NEIGHBOUR_KEYFRAMES + 1
        ]
        nearby_frames = {*numbers[begin:end], *nearby_keyframes}
        return sorted(nearby_frames | self._distant_keyframes(nearby_frames, positions, depth))

    def _distant_keyframes(
        self, neighbours: set[int], positions: np.ndarray, depth: np.ndarray
    ) -> set[int]:
        """Return distant keyframes that see most points, (N, 3), from similar distances, (N,)."""
        result, keyframes = self._frames.result, self._frames.keyframes
        count = min(SAMPLED_POINTS, len(positions))
        sample = np.linspace(0, len(positions) - 1, count).astype(np.intp)
        poses = result.poses[keyframes]
        camera_points = (positions[sample] - poses[:, None, :3, 3]) @ poses[:, :3, :3]
        z = camera_points[..., 2]
        height, width = result.shape
        with np.errstate(invalid="ignore", divide="ignore"):
            image_points = camera_points[..., :2] / z[..., None] * result.camera.focal
            image_points += result.camera.center_for(height, width)
            is_similar = (z > 0) & (np.abs(np.log(z / depth[sample])) < np.log(MAX_DISTANCE_RATIO))
        is_inside = ((image_points >= 0) & (image_points < (width, height))).all(axis=-1)
        visible_share = (is_similar & is_inside).mean(axis=1)
        visible_share[np.isin(keyframes, list(neighbours))] = 0
        candidates = np.argsort(-visible_share, kind="stable")[:DISTANT_KEYFRAMES]
        return {keyframes[k] for k in candidates if visible_share[k] >= MIN_VISIBLE_SHARE}

    def _neighbours(self, frame: int, positions: np.ndarray, depth: np.ndarray) -> list[int]:
        """Return frames before and after a frame, in the order of time."""
        numbers = self._frames.numbers
        index = bisect_left(numbers, frame)
        steps = sorted({sign * step for step in NEIGHBOUR_STEPS for sign in (-1, 1)})
        return [numbers[index + step] for step in steps if 0 <= index + step < len(numbers)]


MAX_TRACK_LENGTH = 48  # frames; a longer track continues as a new track; set by hand
INITIAL_RELATIVE_STD = 1.0  # of the initial depth: so large that it hardly restrains a point


@dataclass
class _Group:
    """Tracks that begin in one frame, or continue there as new tracks."""

    tracks: np.ndarray  # (N,) int64, ascending
    frames: list[int] = field(default_factory=list)
    # for every frame: (N, 2), px; NaN for a lost point
    image_points: list[np.ndarray] = field(default_factory=list)

    def add(self, frame: int, observations: Observations) -> np.ndarray:
        """Add the positions of tracks in a frame; return which observations are of the group."""
        is_own = np.isin(observations.tracks, self.tracks)
        image_points = np.full((len(self.tracks), 2), np.nan)
        image_points[np.searchsorted(self.tracks, observations.tracks[is_own])] = (
            observations.points[is_own]
        )
        if is_own.any():
            self.frames.append(frame)
            self.image_points.append(image_points)
        return is_own


def track_along_flow(
    frames: PieceFrames,
    # number of cells along the longer side; a new point begins in each cell without a point
    cells: int,
    # called with the number of finished frames and of all frames
    progress: Callable[[int, int], None],
) -> list[ObservedPoints]:
    """Return points with parallax whose observations follow the image motion."""
    groups = []
    for group in _groups(frames, cells, progress):
        groups += _triangulate_group(frames, group)
    return groups


def _groups(
    frames: PieceFrames, cells: int, progress: Callable[[int, int], None]
) -> Iterator[_Group]:
    """Track points through all frames; yield groups of tracks when they end."""
    groups: list[_Group] = []
    for count, (frame, observations) in enumerate(_tracks_of_frames(frames, cells), start=1):
        is_new = np.ones(len(observations.tracks), bool)
        open_groups = []
        for group in groups:
            is_own = group.add(frame, observations)
            if is_own.any() and len(group.frames) < MAX_TRACK_LENGTH:
                open_groups.append(group)
                is_new &= ~is_own
            else:
                yield group
        if is_new.any():
            group = _Group(tracks=observations.tracks[is_new])
            group.add(frame, observations)
            open_groups.append(group)
        groups = open_groups
        progress(count, len(frames.numbers))
    yield from groups


def _tracks_of_frames(frames: PieceFrames, cells: int) -> Iterator[tuple[int, Observations]]:
    """Yield frames and their tracks; a track ends where the image patches differ."""
    tracker = Tracker(frames.result.camera, TRACKING_SETTINGS, cells)
    previous, lost_tracks = None, np.empty(0, np.int64)
    for frame, grey in zip(frames.numbers, map(frames.grey, frames.numbers), strict=True):
        observations = tracker.track(grey, ~frames.usable_pixels(frame))
        if previous is not None:
            previous_grey, previous_tracks = previous
            previous_index, index = previous_tracks.common_tracks(observations)
            is_reliable = are_reliable(
                previous_grey,
                grey,
                previous_tracks.points[previous_index],
                observations.points[index],
            )
            lost_tracks = np.union1d(
                np.intersect1d(lost_tracks, observations.tracks),
                observations.tracks[index[~is_reliable]],
            )
        previous = grey, observations
        is_alive = ~np.isin(observations.tracks, lost_tracks)
        yield frame, observations.select(is_alive)


def _triangulate_group(frames: PieceFrames, group: _Group) -> list[ObservedPoints]:
    """Return the points on which the tracks of a group agree."""
    if len(group.frames) < frames.min_observations:
        return []
    image_points = np.stack(group.image_points, axis=1)
    observations = [
        Observations(points=points_of_frame[is_known], tracks=group.tracks[is_known])
        for points_of_frame in group.image_points
        for is_known in [np.isfinite(points_of_frame[:, 0])]
    ]
    poses = [frames.pose(frame) for frame in group.frames]
    result = frames.result
    matrices = {k: pose.matrix for k, pose in enumerate(poses)}
    initial = triangulate_tracks(observations, matrices, result.camera, result.shape)
    in_front = (initial.positions - poses[0].matrix[:3, 3]) @ poses[0].matrix[:3, 2] > 0
    initial = initial.select(initial.tracks[in_front])
    if not len(initial):
        return []
    image_points = image_points[np.searchsorted(group.tracks, initial.tracks)]
    std = np.full(len(initial), INITIAL_RELATIVE_STD)
    _, image_points, points = consistent_points(
        image_points, poses, result.shape, initial.positions, std, frames.min_observations
    )
    return [
        ObservedPoints(
            frames=group.frames,
            image_points=image_points,
            positions=points.positions,
            residual=points.residual,
            colors=frames.colors(group.frames[0], image_points[:, 0]),
        )
    ]
