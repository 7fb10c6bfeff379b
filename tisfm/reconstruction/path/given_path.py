"""A given camera path: its poses by frame, and triangulated points."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.given_poses import find_frame_poses
from tisfm.reconstruction.rolling_shutter.correction import ReadoutCorrection
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks
from tisfm.trajectory import Trajectory


def take_given_path(
    tracks: SequenceTracks,
    trajectory: Trajectory,  # given poses; with a rolling shutter, the poses of middle rows
    # Pinhole camera of the frames. An unknown readout counts as 0: it is not estimated.
    camera: Camera,
    times: Sequence[float | None],  # times of the frames, s; None if unknown
    # (N,) array: `times` in intervals between frames of the source (`tisfm.shutter.frame_instants`)
    instants: np.ndarray,
) -> CameraPath:
    """Return the camera path for given poses, with triangulated points.

    Raises InputError if poses do not fit the frames in number or in time.
    """
    observations: Sequence[Observations] = tracks.observations
    poses, missing = find_frame_poses(trajectory, times)
    known_poses = {k: pose for k, pose in enumerate(poses) if k not in missing}
    points = triangulate_tracks(observations, known_poses, camera, tracks.shape)
    piece, rolling = Piece(poses=known_poses, views=tuple(known_poses), points=points), None
    if known_poses and camera.readout:
        correction = ReadoutCorrection(
            observations, [piece], instants, camera.readout, 0.0, camera, tracks.shape
        )
        observations, rolling = correction.correct_all_tracks(), correction.rolling
        points = triangulate_tracks(observations, known_poses, camera, tracks.shape)
        piece = replace(piece, points=points)
    return CameraPath(
        pieces=(piece,) if known_poses else (),
        missing=missing,
        observations=observations,
        camera=camera,
        rolling=rolling,
    )
