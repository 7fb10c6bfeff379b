"""The tracks of the largest piece of a path, and how two cameras explain them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.camera_adjustment import AdjustedCamera, adjust_camera
from tisfm.reconstruction.calibration.track_bundle import TrackBundle
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.settings import REVISION
from tisfm.reconstruction.tracks.tracker import Observations


def choose_largest_piece(path: CameraPath) -> Piece:
    """Return the piece with the most frames among those with positions; there is at least one."""
    return max(path.pieces_with_positions, key=lambda piece: len(piece.poses))


def count_views(path: CameraPath) -> int:
    """Return the number of views of the largest piece; 0 without a piece with positions."""
    return len(choose_largest_piece(path).views) if path.pieces_with_positions else 0


def choose_frames(path: CameraPath) -> list[int]:
    """Return the frames of the largest piece that show whether one camera suffices, in order.

    They are its views. If these are too few, frames that are spread over the piece join them: a
    zoom of a forward motion shows in the curvature of paths over many frames only.
    """
    piece = choose_largest_piece(path)
    if len(piece.views) >= REVISION.min_views:
        return list(piece.views)
    frames = list(piece.poses)
    places = np.linspace(0, len(frames) - 1, REVISION.min_frames).round().astype(int)
    return sorted({*piece.views, *(frames[place] for place in places)})


def count_posed_frames(path: CameraPath) -> int:
    """Return the number of frames with a pose."""
    return sum(len(piece.poses) for piece in path.pieces)


def make_bundle(
    path: CameraPath,
    shape: tuple[int, int],  # height and width of the frames, px
    frames: Sequence[int] | None = None,  # frames of the largest piece; by default its views
    observations: Sequence[Observations] | None = None,  # by frame; by default of the path
) -> TrackBundle:
    """Return the tracks of the largest piece of a path in some of its frames."""
    if frames is None:
        frames = choose_largest_piece(path).views
    return TrackBundle.from_piece(
        choose_largest_piece(path),
        path.observations if observations is None else observations,
        frames,
        path.camera.pinhole(),
        shape,
    )


def adjust_largest_piece(
    path: CameraPath,
    shape: tuple[int, int],  # height and width of the frames, px
    free: Sequence[str],  # as for `adjust_camera`
    observations: Sequence[Observations] | None = None,  # as for `make_bundle`
    **options: Any,  # as for `adjust_camera`
) -> AdjustedCamera:
    """Adjust the views of the largest piece of a path, from its focal length."""
    bundle = make_bundle(path, shape, observations=observations)
    return adjust_camera(bundle, path.camera.focal, free, **options)


def has_other_focal(adjusted: AdjustedCamera, camera: Camera) -> bool:
    """Return whether the focal length of an adjustment clearly differs from that of a camera."""
    deviation = float(adjusted.common_deviation[0])
    limit = max(REVISION.max_focal_change, REVISION.max_focal_deviations * deviation)
    return not abs(np.log(adjusted.focal / camera.focal)) < limit


def compare_costs(first: AdjustedCamera, second: AdjustedCamera) -> float:
    """Return the robust cost of an adjustment over that of another, on the tracks of both."""
    _, rows, others = np.intersect1d(first.bundle.tracks, second.bundle.tracks, return_indices=True)
    if not len(rows):
        return float("inf")
    return float(first.costs[rows].sum() / second.costs[others].sum())
