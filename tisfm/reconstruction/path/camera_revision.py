"""A zoom, or the distortion of a lens, that a path was solved without.

The tracks of the path are adjusted with one camera, and with a richer camera: a focal length for
each frame, and a distorting lens. If the richer camera explains them clearly better, the path is
solved again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.camera_adjustment import (
    COMMON,
    AdjustedCamera,
    TrackBundle,
    adjust_camera,
)
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.mapping.solution import FocalEstimate, Piece
from tisfm.reconstruction.path.path_solver import CameraPath, PathSolver
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


def largest_piece(path: CameraPath) -> Piece:
    return max(path.pieces, key=lambda piece: len(piece.poses))


def bundle_of(path: CameraPath, views: Sequence[int], shape, observations=None) -> TrackBundle:
    return TrackBundle.from_piece(
        largest_piece(path),
        path.observations if observations is None else observations,
        views,
        path.camera.pinhole(),
        shape,
    )


def gain(base: AdjustedCamera, other: AdjustedCamera) -> float:
    """Cost of another camera over that of the base, on tracks of both."""
    _, rows, others = np.intersect1d(base.bundle.tracks, other.bundle.tracks, return_indices=True)
    return float(other.costs[others].sum() / base.costs[rows].sum())


def is_suspicious(path: CameraPath, free, shape, score=None) -> bool:
    if score is not None and score < 0.65:
        return True
    views = list(largest_piece(path).views)
    size = CALIBRATION.revision_views
    for begin in range(0, max(1, len(views) - size // 2), size):
        window = views[begin : begin + size]
        if len(window) < 3:
            continue
        bundle = bundle_of(path, window, shape)
        base = adjust_camera(bundle, path.camera.focal, free, scales=(0.5,), steps=8)
        rich = adjust_camera(base.bundle, base.focal, COMMON, has_zoom=True, scales=(0.5,), steps=15)
        if rich.cost < CALIBRATION.max_rich_cost * base.cost:
            return True
    return False


def frame_zooms(frames: Sequence[int], zoom: np.ndarray, count: int) -> np.ndarray:
    return np.interp(np.arange(count), frames, zoom)


def unzoom_points(points: np.ndarray, zoom: float, center: np.ndarray) -> np.ndarray:
    return (points - center) * np.exp(-zoom) + center


def unzoom_tracks(tracks: SequenceTracks, zoom: np.ndarray, camera: Camera) -> SequenceTracks:
    center = np.array(camera.center_for(*tracks.shape))

    def unzoomed(observations: Observations, frame: int) -> Observations:
        if not len(observations.points):
            return observations
        return replace(observations, points=unzoom_points(observations.points, zoom[frame], center))

    observations = DiskCache(Observations.to_arrays, Observations.from_arrays)
    for frame, in_frame in enumerate(tracks.observations):
        observations.append(unzoomed(in_frame, frame))
    views = DiskCache(View.to_arrays, View.from_arrays)
    for view in tracks.views:
        views.append(
            replace(
                view,
                observations=unzoomed(view.observations, view.frame),
                detected=unzoom_points(view.detected, zoom[view.frame], center),
            )
        )
    return replace(tracks, observations=observations, views=views)


def solve_zoom(path: CameraPath, solver: PathSolver, instants: np.ndarray):
    """Return the path of the unzoomed tracks, the zoom of each frame, and the adjusted camera."""
    shape, count = solver.tracks.shape, len(solver.tracks.observations)
    total = np.zeros(count)
    for _ in range(3):
        views = list(largest_piece(path).views)
        found = adjust_camera(
            bundle_of(path, views, shape), path.camera.focal, ("focal",), has_zoom=True
        )
        change = frame_zooms(found.bundle.frames, found.zoom, count)
        total = total + change
        if np.abs(change).max() < 0.003:
            break
        path = replace(solver, tracks=unzoom_tracks(solver.tracks, total, solver.camera)).solve(instants)
        if not path.pieces:
            return None
    return path, total, found
