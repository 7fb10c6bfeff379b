"""Triangulation of tracks with known poses."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.geometry.rays import nearest_point_equations, pinhole_rays, unit_vectors
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.reconstruction.tracks.tracker import Observations

# Observations that are triangulated at a time, to bound the memory. Set by hand.
MAX_OBSERVATIONS = 2**18


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackPoints(Mapping[int, np.ndarray]):
    """Points of tracks: a mapping from track numbers to positions, stored in two arrays."""

    tracks: np.ndarray  # (N,) int64: track numbers, ascending
    positions: np.ndarray  # (N, 3) float64

    @classmethod
    def from_mapping(cls, points: Mapping[int, np.ndarray]) -> "TrackPoints":
        """Return the points of a mapping."""
        tracks = np.array(sorted(points), np.int64)
        positions = np.array([points[track] for track in tracks.tolist()], np.float64)
        return cls(tracks=tracks, positions=positions.reshape(-1, 3))

    def __or__(self, others: "TrackPoints") -> "TrackPoints":
        """Return both sets of points; a track in both sets keeps its point of `others`."""
        is_only_here = ~np.isin(self.tracks, others.tracks)
        tracks = np.concatenate([self.tracks[is_only_here], others.tracks])
        positions = np.vstack([self.positions[is_only_here], others.positions])
        order = np.argsort(tracks)
        return TrackPoints(tracks=tracks[order], positions=positions[order])

    def select(self, tracks: np.ndarray) -> "TrackPoints":
        """Return the points of some tracks."""
        is_selected = np.isin(self.tracks, tracks)
        return TrackPoints(tracks=self.tracks[is_selected], positions=self.positions[is_selected])

    def __getitem__(self, track: int) -> np.ndarray:
        index = int(np.searchsorted(self.tracks, track))
        if index == len(self.tracks) or self.tracks[index] != track:
            raise KeyError(track)
        return np.asarray(self.positions[index])

    def __iter__(self) -> Iterator[int]:
        return iter(self.tracks.tolist())

    def __len__(self) -> int:
        return len(self.tracks)


def points_of_tracks(
    observations: Observations, points: Mapping[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of a frame's tracks with points, (M,), and the points, (M, 3)."""
    if isinstance(points, TrackPoints):
        indices = np.searchsorted(points.tracks, observations.tracks)
        indices[indices == len(points)] = 0
        has_point = (
            points.tracks[indices] == observations.tracks
            if len(points)
            else np.zeros(len(indices), bool)
        )
        return np.flatnonzero(has_point), points.positions[indices[has_point]]
    index = [k for k, track in enumerate(observations.tracks.tolist()) if track in points]
    positions = np.array([points[track] for track in observations.tracks[index].tolist()])
    return np.array(index, np.intp), positions.reshape(-1, 3)


def triangulate_tracks(
    observations: Sequence[Observations],  # tracks in every frame
    poses: Mapping[int, np.ndarray],  # by frame: (4, 4), camera to world
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],  # height and width of the frames, px
) -> TrackPoints:
    """Triangulate tracks: return the points nearest to the rays of their observations."""
    batches = [_triangulate(batch, poses, camera, shape) for batch in _batches(observations, poses)]
    return TrackPoints(
        tracks=np.concatenate([batch.tracks for batch in batches]),
        positions=np.vstack([batch.positions for batch in batches]),
    )


def _batches(
    observations: Sequence[Observations], poses: Mapping[int, np.ndarray]
) -> Iterator[Mapping[int, Observations]]:
    """Yield observations in frames with poses: some tracks at a time, to bound the memory."""
    lengths = np.zeros(0, np.int64)
    track_ranges = {}  # by frame: numbers of the oldest and the newest track
    for frame in poses:
        tracks = observations[frame].tracks
        if not len(tracks):
            continue
        track_ranges[frame] = tracks[0], tracks[-1]
        if tracks[-1] >= len(lengths):
            lengths = np.concatenate([lengths, np.zeros(tracks[-1] + 1 - len(lengths), np.int64)])
        lengths[tracks] += 1
    if lengths.sum() <= MAX_OBSERVATIONS:
        yield {frame: observations[frame] for frame in poses}
        return
    batch_of_track = np.cumsum(lengths) // MAX_OBSERVATIONS
    for begin in np.flatnonzero(np.diff(batch_of_track, prepend=-1)).tolist():
        end = int(np.searchsorted(batch_of_track, batch_of_track[begin], side="right"))
        observations_of_batch = {}
        for frame, (oldest, newest) in track_ranges.items():
            if newest < begin or oldest >= end:
                continue
            frame_observations = observations[frame]
            first, last = np.searchsorted(frame_observations.tracks, (begin, end))
            if last > first:
                observations_of_batch[frame] = Observations(
                    points=frame_observations.points[first:last],
                    tracks=frame_observations.tracks[first:last],
                )
        yield observations_of_batch


def _triangulate(
    observations: Mapping[int, Observations],
    poses: Mapping[int, np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
) -> TrackPoints:
    cx, cy = camera.center_for(*shape)
    tracks, centres, rays, positions, frames = [], [], [], [], []
    for frame, frame_observations in observations.items():
        points, pose = frame_observations.points, poses[frame]
        ray = pinhole_rays(points, camera, shape) @ pose[:3, :3].T
        tracks.append(frame_observations.tracks)
        rays.append(unit_vectors(ray))
        centres.append(np.broadcast_to(pose[:3, 3], ray.shape))
        positions.append(points)
        frames.append(np.full(len(points), frame))
    if not tracks:
        return TrackPoints.from_mapping({})
    track_numbers, index = np.unique(np.concatenate(tracks), return_inverse=True)
    ray, centre, position, frame_of_observation = map(
        np.concatenate, (rays, centres, positions, frames)
    )
    count = np.bincount(index)
    matrix, vector = nearest_point_equations(index, ray, centre, len(track_numbers))
    # The smallest eigenvalue is 0 for parallel rays, else count · sin² of their spread.
    min_eigenvalue = np.linalg.eigvalsh(matrix)[:, 0]
    is_valid = (count >= TRACKS.min_frames) & (
        min_eigenvalue > count * np.sin(np.radians(TRACKS.min_angle) / 2) ** 2
    )
    point = np.zeros((len(track_numbers), 3))
    point[is_valid] = np.linalg.solve(matrix[is_valid], vector[is_valid][..., None])[..., 0]
    residual = np.full(len(index), np.inf)
    for frame in observations:
        in_frame, pose = frame_of_observation == frame, poses[frame]
        local = (point[index[in_frame]] - pose[:3, 3]) @ pose[:3, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            projected = local[:, :2] / local[:, 2:] * camera.focal + (cx, cy)
        distance = np.hypot(*(projected - position[in_frame]).T)
        residual[in_frame] = np.where(local[:, 2] > 0, np.nan_to_num(distance, nan=np.inf), np.inf)
    order = np.lexsort((residual, index))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    # The lower median of the residuals of each track is bounded.
    is_valid &= residual[order][first + (count - 1) // 2] < TRACKS.max_median_residual
    return TrackPoints(tracks=track_numbers[is_valid], positions=point[is_valid])


def track_depths(
    observations: Observations, points: Mapping[int, np.ndarray], pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions, (N, 2) px, and the depths, (N,), of tracks in front of the camera."""
    has_point, world = points_of_tracks(observations, points)
    depth = (world - pose[:3, 3]) @ pose[:3, 2]
    return observations.points[has_point][depth > 0], depth[depth > 0]
