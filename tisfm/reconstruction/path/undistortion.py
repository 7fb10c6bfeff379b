"""Tracks and views as a pinhole would see them."""

from collections.abc import Sequence

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.self_calibration import (
    undistort_observations,
    undistort_points,
)
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


def undistort_tracks(
    tracks: Sequence[Observations], camera: Camera, shape: tuple[int, int]
) -> Sequence[Observations]:
    """Return the tracks of every frame as a pinhole would see them."""
    if camera.is_pinhole:
        return tracks
    undistorted = DiskCache(Observations.to_arrays, Observations.from_arrays)
    for observations in tracks:
        undistorted.append(undistort_observations(observations, camera, shape))
    return undistorted


def undistort_views(
    views: Sequence[View], camera: Camera, shape: tuple[int, int]
) -> Sequence[View]:
    """Return views as a pinhole would see them."""
    if camera.is_pinhole:
        return views
    undistorted = DiskCache(View.to_arrays, View.from_arrays)
    for view in views:
        undistorted.append(
            View(
                frame=view.frame,
                observations=undistort_observations(view.observations, camera, shape),
                detected=undistort_points(view.detected, camera, shape),
            )
        )
    return undistorted
