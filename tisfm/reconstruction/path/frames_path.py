"""The path of frames, which is found, or given."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.frame_flow import TRACKING_SETTINGS
from tisfm.reconstruction.mapping.solution import MAX_USEFUL_DEVIATION, Piece
from tisfm.reconstruction.path.given_poses import poses_of_frames
from tisfm.reconstruction.path.path_finder import CameraPath, PathFinder
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.rolling_shutter.unrolled_tracks import TrackUnroller
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks
from tisfm.trajectory import Trajectory


class FramesPath:
    """Takes the frames of a sequence one after the other, and returns their path.

    Parameters
    ----------
    camera : Camera
        A pinhole, of the frames.
    given : Trajectory or None
        The path, if it is known: points are found alone then.
    calibrate : {"nothing", "focal", "radial"}
        What of the camera is found from the frames.
    limit : float
        As for `tisfm.reconstruction.path.path_finder.PathFinder`.
    readout : float or None
        Of the shutter, as in `tisfm.Camera`; None if it is found, which a known path does not show.
    focal_known : bool
        As for `tisfm.reconstruction.path.path_finder.PathFinder`.
    """

    def __init__(
        self,
        camera: Camera,
        given: Trajectory | None,
        calibrate: Calibrate,
        *,
        limit: float = MAX_USEFUL_DEVIATION,
        readout: float | None = None,
        focal_known: bool = True,
    ) -> None:
        self._camera, self._given, self._readout = camera, given, readout
        self._shape = (0, 0)
        self._seen = DiskCache(Observations.arrays, Observations.of_arrays)
        self._tracker = Tracker(camera, TRACKING_SETTINGS)
        self._finder = PathFinder(
            camera, calibrate, limit=limit, readout=readout, focal_known=focal_known
        )

    def add(
        self,
        grey: np.ndarray,
        ignored: np.ndarray | None = None,
        flow: np.ndarray | None = None,
    ) -> None:
        """Take the next frame, as `tisfm.reconstruction.path.path_finder.PathFinder.add` does."""
        self._shape = grey.shape
        if self._given is None:
            self._finder.add(grey, ignored, flow)
        else:
            self._seen.append(self._tracker.track(grey, ignored, flow))

    def finish(self, times: Sequence[float | None], instants: np.ndarray) -> CameraPath:
        """Return the path of the frames.

        Parameters
        ----------
        times : sequence of float or None
            When they were taken, s; None where that is not known.
        instants : (N,) array
            The same in intervals between frames of the source.

        Raises
        ------
        ValueError
            If frames are out of order, or poses do not fit them.
        """
        if self._given is None:
            return self._finder.finish(instants)
        camera, shape = self._camera, self._shape
        seen: Sequence[Observations] = self._seen
        poses, lost = poses_of_frames(self._given, times)
        known = {k: pose for k, pose in enumerate(poses) if k not in lost}
        points = triangulate_tracks(seen, known, camera, shape)
        piece, rolling = Piece(poses=known, views=tuple(known), points=points), None
        if known and self._readout:  # poses are those of middle rows
            unrolling = TrackUnroller(seen, [piece], instants, self._readout, 0.0, camera, shape)
            seen, rolling = unrolling.all_tracks(), unrolling.rolling
            piece = replace(piece, points=triangulate_tracks(seen, known, camera, shape))
        return CameraPath(
            pieces=(piece,) if known else (),
            lost=lost,
            seen=seen,
            camera=camera,
            rolling=rolling,
        )
