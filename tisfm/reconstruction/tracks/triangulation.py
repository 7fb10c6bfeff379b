"""Triangulation of tracks with known poses."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.geometry.rays import nearest_point_equations, pinhole_rays, unit_vectors
from tisfm.reconstruction.tracks.tracker import Observations

# Values without a stated source were set by hand.

# The fewest frames that see a track.
MIN_FRAMES = 2
# Degrees: smallest angle between the rays of a track: a smaller angle shows no depth.
MIN_ANGLE = 0.5
# px: largest median residual of a track.
MAX_MEDIAN_RESIDUAL = 3.0
# Observations that are triangulated at a time, to bound the memory.
MAX_OBSERVATIONS = 2**18


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackPoints(Mapping[int, np.ndarray]):
    """Points of tracks: a mapping from track numbers to positions, stored in two arrays."""

    tracks: np.ndarray  # (N,) int64: track numbers, ascending
    positions: np.ndarray  # (N, 3) float64

    @classmethod
    def of(cls, points: Mapping[int, np.ndarray]) -> "TrackPoints":
        """Return the points of a mapping."""
        tracks = np.array(sorted(points), np.int64)
        positions = np.array([points[track] for track in tracks.tolist()], np.float64)
        return cls(tracks=tracks, positions=positions.reshape(-1, 3))

    def __or__(self, others: "TrackPoints") -> "TrackPoints":
        """Return these points and others; of a track in both, the other point is used."""
        kept = ~np.isin(self.tracks, others.tracks)
        tracks = np.concatenate([self.tracks[kept], others.tracks])
        positions = np.vstack([self.positions[kept], others.positions])
        order = np.argsort(tracks)
        return TrackPoints(tracks=tracks[order], positions=positions[order])

    def among(self, tracks: np.ndarray) -> "TrackPoints":
        """Return the points of some tracks."""
        kept = np.isin(self.tracks, tracks)
        return TrackPoints(tracks=self.tracks[kept], positions=self.positions[kept])

    def __getitem__(self, track: int) -> np.ndarray:
        place = int(np.searchsorted(self.tracks, track))
        if place == len(self.tracks) or self.tracks[place] != track:
            raise KeyError(track)
        return np.asarray(self.positions[place])

    def __iter__(self) -> Iterator[int]:
        return iter(self.tracks.tolist())

    def __len__(self) -> int:
        return len(self.tracks)


def points_of_tracks(
    seen: Observations, points: Mapping[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of a frame's tracks with points, (M,), and the points, (M, 3)."""
    if isinstance(points, TrackPoints):
        places = np.searchsorted(points.tracks, seen.tracks)
        places[places == len(points)] = 0
        known = points.tracks[places] == seen.tracks if len(points) else np.zeros(len(places), bool)
        return np.flatnonzero(known), points.positions[places[known]]
    index = [k for k, track in enumerate(seen.tracks.tolist()) if track in points]
    positions = np.array([points[track] for track in seen.tracks[index].tolist()])
    return np.array(index, np.intp), positions.reshape(-1, 3)


def triangulate_tracks(
    seen: Sequence[Observations],  # observations of every frame
    poses: Mapping[int, np.ndarray],  # mapping of int to (4, 4) array: camera to world, by frame
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],  # height and width of the frames, px
) -> TrackPoints:
    """Triangulate tracks: return the points nearest to the rays of their observations."""
    found = [_triangulated(few, poses, camera, shape) for few in _lots(seen, poses)]
    return TrackPoints(
        tracks=np.concatenate([one.tracks for one in found]),
        positions=np.vstack([one.positions for one in found]),
    )


def _lots(
    seen: Sequence[Observations], poses: Mapping[int, np.ndarray]
) -> Iterator[Mapping[int, Observations]]:
    """Yield observations in frames with poses, of some tracks at a time, to bound the memory."""
    count = np.zeros(0, np.int64)
    spans = {}  # oldest and newest track, by frame
    for frame in poses:
        tracks = seen[frame].tracks
        if not len(tracks):
            continue
        spans[frame] = tracks[0], tracks[-1]
        if tracks[-1] >= len(count):
            count = np.concatenate([count, np.zeros(tracks[-1] + 1 - len(count), np.int64)])
        count[tracks] += 1
    if count.sum() <= MAX_OBSERVATIONS:
        yield {frame: seen[frame] for frame in poses}
        return
    lot = np.cumsum(count) // MAX_OBSERVATIONS
    for begin in np.flatnonzero(np.diff(lot, prepend=-1)).tolist():
        end = int(np.searchsorted(lot, lot[begin], side="right"))
        some = {}
        for frame, (oldest, newest) in spans.items():
            if newest < begin or oldest >= end:
                continue
            one = seen[frame]
            first, last = np.searchsorted(one.tracks, (begin, end))
            if last > first:
                some[frame] = Observations(
                    points=one.points[first:last], tracks=one.tracks[first:last]
                )
        yield some


def _triangulated(
    seen: Mapping[int, Observations],
    poses: Mapping[int, np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
) -> TrackPoints:
    cx, cy = camera.center_for(*shape)
    tracks, centres, rays, places, frames = [], [], [], [], []
    for frame, one in seen.items():
        points, pose = one.points, poses[frame]
        ray = pinhole_rays(points, camera, shape) @ pose[:3, :3].T
        tracks.append(one.tracks)
        rays.append(unit_vectors(ray))
        centres.append(np.broadcast_to(pose[:3, 3], ray.shape))
        places.append(points)
        frames.append(np.full(len(points), frame))
    if not tracks:
        return TrackPoints.of({})
    numbers, index = np.unique(np.concatenate(tracks), return_inverse=True)
    ray, centre, place, frame_of = map(np.concatenate, (rays, centres, places, frames))
    count = np.bincount(index)
    matrix, vector = nearest_point_equations(index, ray, centre, len(numbers))
    # The smallest eigenvalue is 0 for parallel rays, else count · sin² of their spread.
    least = np.linalg.eigvalsh(matrix)[:, 0]
    good = (count >= MIN_FRAMES) & (least > count * np.sin(np.radians(MIN_ANGLE) / 2) ** 2)
    point = np.zeros((len(numbers), 3))
    point[good] = np.linalg.solve(matrix[good], vector[good][..., None])[..., 0]
    residual = np.full(len(index), np.inf)
    for frame in seen:
        mine, pose = frame_of == frame, poses[frame]
        local = (point[index[mine]] - pose[:3, 3]) @ pose[:3, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            there = local[:, :2] / local[:, 2:] * camera.focal + (cx, cy)
        off = np.hypot(*(there - place[mine]).T)
        residual[mine] = np.where(local[:, 2] > 0, np.nan_to_num(off, nan=np.inf), np.inf)
    order = np.lexsort((residual, index))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    good &= residual[order][first + (count - 1) // 2] < MAX_MEDIAN_RESIDUAL
    return TrackPoints(tracks=numbers[good], positions=point[good])


def track_depths(
    seen: Observations, points: Mapping[int, np.ndarray], pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions, (N, 2), and depth of a frame's tracks with points before the camera."""
    known, world = points_of_tracks(seen, points)
    depth = (world - pose[:3, 3]) @ pose[:3, 2]
    return seen.points[known][depth > 0], depth[depth > 0]
