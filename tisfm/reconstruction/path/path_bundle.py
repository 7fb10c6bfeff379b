"""The tracks of the largest piece of a path, and how two cameras explain them."""

from collections.abc import Sequence

import numpy as np

from tisfm.reconstruction.calibration.camera_adjustment import AdjustedCamera
from tisfm.reconstruction.calibration.track_bundle import TrackBundle
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.path_solver import CameraPath
from tisfm.reconstruction.tracks.tracker import Observations


def largest_piece(path: CameraPath) -> Piece:
    """Return the piece with the most frames among those with positions; there is at least one."""
    return max(path.pieces_with_positions, key=lambda piece: len(piece.poses))


def count_views(path: CameraPath) -> int:
    """Return the number of views of the largest piece; 0 without a piece with positions."""
    return len(largest_piece(path).views) if path.pieces_with_positions else 0


def posed_count(path: CameraPath) -> int:
    """Return the number of frames with a pose."""
    return sum(len(piece.poses) for piece in path.pieces)


def bundle_of(
    path: CameraPath,
    frames: Sequence[int],  # frames of the largest piece
    shape: tuple[int, int],  # height and width of the frames, px
    observations: Sequence[Observations] | None = None,  # by frame; by default of the path
) -> TrackBundle:
    """Return the tracks of the largest piece of a path in some of its frames."""
    return TrackBundle.from_piece(
        largest_piece(path),
        path.observations if observations is None else observations,
        frames,
        path.camera.pinhole(),
        shape,
    )


def relative_cost(first: AdjustedCamera, second: AdjustedCamera) -> float:
    """Return the robust cost of an adjustment over that of another, on the tracks of both."""
    _, rows, others = np.intersect1d(first.bundle.tracks, second.bundle.tracks, return_indices=True)
    if not len(rows):
        return float("inf")
    return float(first.costs[rows].sum() / second.costs[others].sum())
