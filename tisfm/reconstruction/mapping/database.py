"""pycolmap, its camera, and its database of views and their matches."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.geometry.rays import pinhole_rays, unit_vectors
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View

# The number of pycolmap's two-view configuration "calibrated".
CALIBRATED_PAIR = 2
# px: the centre of pycolmap's upper left pixel is at (0.5, 0.5).
PIXEL_CENTRE = 0.5


@cache
def pycolmap() -> Any:
    """Return the module pycolmap, which then writes only fatal errors to standard error."""
    import pycolmap as module

    log = module.logging
    log.minloglevel = log.FATAL.value
    return module


def colmap_camera(camera: Camera, shape: tuple[int, int], calibrate: Calibrate = "nothing") -> Any:
    """Return pycolmap's camera; `calibrate` chooses the parameters that may be estimated."""
    height, width = shape
    cx, cy = camera.center_for(height, width)
    focal, center = camera.focal, (cx + PIXEL_CENTRE, cy + PIXEL_CENTRE)
    model, params = {
        "nothing": ("PINHOLE", [focal, focal, *center]),
        "focal": ("SIMPLE_PINHOLE", [focal, *center]),
        "radial": ("SIMPLE_RADIAL", [focal, *center, 0.0]),
    }[calibrate]
    result = pycolmap().Camera(model=model, width=width, height=height, params=params, camera_id=1)
    result.has_prior_focal_length = True  # so that the search for first pairs uses it
    return result


def match_pairs(
    views: Sequence[View], matches: Mapping[tuple[int, int], np.ndarray]
) -> dict[tuple[int, int], np.ndarray]:
    """Return, by pair of view indices, the indices of matching points, (N, 2).

    Points of a view are its tracks, followed by its detected points.
    """
    track_pairs = {(k, k + step) for step in MAPPING.view_steps for k in range(len(views) - step)}
    pairs = {}
    for first, second in sorted(track_pairs | set(matches)):
        indices = np.empty((0, 2), np.intp)
        if (first, second) in track_pairs:
            indices = _shared_track_indices(views[first].observations, views[second].observations)
        if (first, second) in matches:
            track_counts = [len(views[k].observations.points) for k in (first, second)]
            indices = np.vstack([indices, matches[first, second] + track_counts])
        if len(indices) >= MAPPING.min_observations:
            pairs[first, second] = indices.astype(np.int32)
    return pairs


@contextmanager
def open_database(
    views: Sequence[View], pairs: Mapping[tuple[int, int], np.ndarray], camera: Any
) -> Iterator[Any]:
    """Open pycolmap's database of views and the matches of pairs of views."""
    database = pycolmap().Database.open(":memory:")
    try:
        _write_views(database, views, camera)
        _write_pairs(database, pairs)
        yield database
    finally:
        database.close()


class MatchDirections(Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]):
    """Unit directions to matching points, by the ids of two views; computed on access.

    The directions of all pairs together would need many times the memory of the views.
    """

    def __init__(
        self,
        views: Sequence[View],
        pairs: Mapping[tuple[int, int], np.ndarray],
        camera: Camera,
        shape: tuple[int, int],
    ) -> None:
        self._pairs, self._rays = pairs, list[np.ndarray]()
        for view in views:
            points = np.vstack([view.observations.points, view.detected])
            self._rays.append(unit_vectors(pinhole_rays(points, camera, shape)))

    def __getitem__(self, view_ids: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        first, second = view_ids[0] - 1, view_ids[1] - 1
        indices = self._pairs[first, second]
        return self._rays[first][indices[:, 0]], self._rays[second][indices[:, 1]]

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return ((first + 1, second + 1) for first, second in self._pairs)

    def __len__(self) -> int:
        return len(self._pairs)


def _write_views(database: Any, views: Sequence[View], camera: Any) -> None:
    database.write_camera(camera, use_camera_id=True)
    rig = pycolmap().Rig(rig_id=1)
    rig.add_ref_sensor(camera.sensor_id)
    database.write_rig(rig, use_rig_id=True)
    for view_id, view in enumerate(views, start=1):
        image = pycolmap().Image(
            name=str(view.frame), camera_id=1, image_id=view_id, frame_id=view_id
        )
        frame = pycolmap().Frame(frame_id=view_id, rig_id=1)
        frame.add_data_id(image.data_id)
        database.write_frame(frame, use_frame_id=True)
        database.write_image(image, use_image_id=True)
        points = np.vstack([view.observations.points, view.detected]) + PIXEL_CENTRE
        database.write_keypoints(view_id, points.astype(np.float32))


def _write_pairs(database: Any, pairs: Mapping[tuple[int, int], np.ndarray]) -> None:
    for (first, second), indices in pairs.items():
        geometry = pycolmap().TwoViewGeometry()
        geometry.config = CALIBRATED_PAIR
        geometry.inlier_matches = indices.astype(np.uint32)
        database.write_two_view_geometry(first + 1, second + 1, geometry)


def _shared_track_indices(first: Observations, second: Observations) -> np.ndarray:
    """Return the indices of shared tracks in two views, (N, 2); none if the views share few."""
    index0, index1 = first.common_tracks(second)
    if len(index0) < MAPPING.min_shared_tracks:
        return np.empty((0, 2), np.intp)
    return np.stack([index0, index1], axis=1)
