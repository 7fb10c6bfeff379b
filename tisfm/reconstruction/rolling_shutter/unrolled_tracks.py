"""Tracks and views corrected for the readout time, as a global shutter would see them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tisfm.camera import Camera
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import points_of_tracks
from tisfm.reconstruction.tracks.views import View
from tisfm.shutter import Rolling, at_middle, rates_of

# Number of tracks around a detected point: the point gets their median depth. Set by hand.
DEPTH_NEIGHBOURS = 3


class TrackUnroller:
    """Moves the points of frames to the positions that a global shutter would see."""

    def __init__(
        self,
        # tracks of every frame, as the camera sees them
        seen: Sequence[Observations] | Mapping[int, Observations],
        pieces: Sequence[Piece],  # each frame is in at most one piece
        # (N,) array, or mapping: time of each frame, in intervals between frames of the source
        instants: np.ndarray | Mapping[int, float],
        # readout, deviation: as in `Rolling`
        readout: float,
        deviation: float,
        camera: Camera,  # pinhole camera
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> None:
        self._seen, self._camera, self._shape = seen, camera, shape
        rates: dict[int, np.ndarray] = {}
        usual: dict[int, float] = {}
        self._depths: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for piece in pieces:
            for frame, rate in rates_of(piece.poses, instants).items():
                depth, known = _depths(seen[frame], piece.points, piece.poses[frame])
                if known.any():
                    rates[frame], usual[frame] = rate, 1 / float(np.median(depth[known]))
                    self._depths[frame] = depth, known
        self.rolling = Rolling(
            camera=camera,
            readout=readout,
            deviation=deviation,
            rates=rates,
            inverse_depth=usual,
        )

    def tracks(self, frame: int) -> Observations:
        """Return the corrected tracks of a frame; tracks that leave the frame are dropped."""
        seen = self._seen[frame]
        if frame not in self._depths:
            return seen
        depth, known = self._depths[frame]
        usual = 1 / self.rolling.inverse_depth[frame]
        points = self._moved(frame, seen.points, np.where(known, depth, usual))
        height, width = self._shape
        inside = ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=1)
        return Observations(points=points[inside], tracks=seen.tracks[inside])

    def all_tracks(self) -> DiskCache[Observations]:
        """Return the corrected tracks of every frame."""
        found = DiskCache(Observations.arrays, Observations.of_arrays)
        for frame in range(len(self._seen)):
            found.append(self.tracks(frame))
        return found

    def view(self, view: View) -> View:
        """Return a corrected view, with all its detected points."""
        frame = view.frame
        if frame not in self._depths or not len(view.detected):
            return replace(view, seen=self.tracks(frame))
        depth, known = self._depths[frame]
        _, near = cKDTree(self._seen[frame].points[known]).query(
            view.detected, k=min(DEPTH_NEIGHBOURS, int(known.sum()))
        )
        around = np.median(depth[known][near].reshape(len(view.detected), -1), axis=1)
        return replace(
            view, seen=self.tracks(frame), detected=self._moved(frame, view.detected, around)
        )

    def _moved(self, frame: int, points: np.ndarray, depth: np.ndarray) -> np.ndarray:
        rolling = self.rolling
        return at_middle(
            points, depth, rolling.rates[frame], rolling.readout, self._camera, self._shape
        )


def _depths(
    seen: Observations, points: Mapping[int, np.ndarray], pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth of each track of a frame, (N,), and whether it is known and positive."""
    known, world = points_of_tracks(seen, points)
    depth = np.zeros(len(seen.tracks))
    depth[known] = (world - pose[:3, 3]) @ pose[:3, 2]
    return depth, depth > 0
