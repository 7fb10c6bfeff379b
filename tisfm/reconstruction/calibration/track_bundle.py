"""The tracks of frames that an adjustment fits: positions, and start values of poses and points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import points_of_tracks
from tisfm.reconstruction.tracks.views import choose_long_tracks


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackBundle:
    """Frames of a piece of a path, points of tracks, and their positions in the frames."""

    frames: tuple[int, ...]  # numbers of the F frames
    tracks: np.ndarray  # (P,) int: numbers of the tracks
    poses: np.ndarray  # (F, 3, 4) float64: world to camera
    points: np.ndarray  # (P, 3) float64: in the world
    views: np.ndarray  # (M,) int: index of the frame of each observation
    indices: np.ndarray  # (M,) int: index of its point
    positions: np.ndarray  # (M, 2) float64: px from the principal point

    @classmethod
    def from_piece(
        cls,
        piece: Piece,
        observations: Sequence[Observations],  # by frame
        frames: Sequence[int],  # frames of the piece that are used
        camera: Camera,  # pinhole camera
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> "TrackBundle":
        """Return the longest tracks of frames of a piece."""
        center = np.array(camera.center_for(*shape))
        selected = choose_long_tracks([observations[frame] for frame in frames], max(shape))
        views, tracks, positions, world = [], [], [], []
        for k, in_frame in enumerate(selected):
            rows, points = points_of_tracks(in_frame, piece.points)
            views.append(np.full(len(rows), k))
            tracks.append(in_frame.tracks[rows])
            positions.append(in_frame.points[rows] - center)
            world.append(points)
        numbers, first, indices, counts = np.unique(
            np.concatenate(tracks), return_index=True, return_inverse=True, return_counts=True
        )
        is_used = counts[indices] >= CALIBRATION.min_bundle_frames
        remaining = np.flatnonzero(counts >= CALIBRATION.min_bundle_frames)
        return cls(
            frames=tuple(frames),
            tracks=numbers[remaining],
            poses=np.array([np.linalg.inv(piece.poses[frame])[:3] for frame in frames]),
            points=np.concatenate(world)[first[remaining]],
            views=np.concatenate(views)[is_used],
            indices=np.searchsorted(remaining, indices[is_used]),
            positions=np.concatenate(positions)[is_used],
        )
