"""Tracks of points through the frames of a reconstruction, measured in the images."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.checks import Floats
from tisfm.errors import InputError
from tisfm.exports.observations import ObservedPoints, PieceFrames
from tisfm.exports.point_tracks import DepthTracks, track_along_flow
from tisfm.reconstruction.result.reconstruction import Reconstruction

CELLS_PER_SIDE = 80  # along the longer side: a cell without a point gets a new one; set by hand


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """Points of one piece, and their observations in frames."""

    positions: Floats  # (P, 3) float64: in the world, in the unit of the poses
    colors: np.ndarray  # (P, 3) uint8: red, green, blue
    # (O,) int32: point of every observation. Observations of the same point are adjacent.
    points: np.ndarray
    frames: np.ndarray  # (O,) int32: frame of every observation
    # (O, 2) float64: measured position (x, y) in the frame, px from the centre of the upper left
    # pixel
    image_points: Floats
    residual: Floats  # (O,) float64: distance of the measured position from the projected point, px

    def __len__(self) -> int:
        return len(self.positions)


def measure_tracks(
    result: Reconstruction,
    piece: int,
    *,
    # distance of new points in a frame, px; by default 1/80 of the longer side
    spacing: float | None = None,
    # called with the number of finished frames and of all frames
    progress: Callable[[int, int], None] | None = None,
) -> Tracks:
    """Measure tracks of corners through the frames of a piece.

    A point begins in a keyframe, at a corner of known depth. Depth and poses predict its position
    in other frames, where it is measured in the images. A point is kept if three frames or more
    agree on one point in space, within 1.5 px in each frame. Moving objects and masked pixels
    have no points. Without any depth, points are tracked from frame to frame along the image
    motion, with the tracker of the reconstruction.

    Raises ValueError if the piece does not exist, or the spacing is not positive.

    Raises FileNotFoundError, tisfm.formats.FormatError if files of the reconstruction are missing
    or damaged.
    """
    if not 0 <= piece < len(result.unit):
        raise InputError(f"piece is {piece}: expected 0 to {len(result.unit) - 1}")
    report_progress = progress or _ignore_progress
    frames, cells = PieceFrames(result, piece), count_cells(result.shape, spacing)
    if not any(map(frames.has_depth, frames.numbers)):
        return _join_groups(track_along_flow(frames, cells, report_progress))
    groups = DepthTracks(frames, cells).find(report_progress)
    if not any(len(group.positions) for group in groups):  # no point was found by depth
        groups = track_along_flow(frames, cells, _ignore_progress)  # progress was already reported
    return _join_groups(groups)


def _ignore_progress(done: int, count: int) -> None:
    """Ignore progress."""


def count_cells(shape: tuple[int, int], spacing: float | None) -> int:
    """Return the number of cells along the longer side of the frames.

    Raises ValueError if the spacing is not a positive number of px.
    """
    if spacing is None:
        return CELLS_PER_SIDE
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing is {spacing}: expected a positive number of px")
    return max(1, round(max(shape) / spacing))


def _join_groups(groups: Sequence[ObservedPoints]) -> Tracks:
    """Return all points with common numbers."""
    arrays = list(_observations(groups))
    points, frames, image_points, residual = (
        np.concatenate([empty, *(group[k] for group in arrays)])
        for k, empty in enumerate(
            (np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 2)), np.empty(0))
        )
    )
    return Tracks(
        positions=np.vstack([np.empty((0, 3)), *(group.positions for group in groups)]),
        colors=np.vstack([np.empty((0, 3), np.uint8), *(group.colors for group in groups)]),
        points=points,
        frames=frames,
        image_points=image_points,
        residual=residual,
    )


def _observations(groups: Sequence[ObservedPoints]) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield points, frames, positions and residuals of observations, point by point."""
    count = 0
    for group in groups:
        point, number = np.nonzero(np.isfinite(group.image_points[..., 0]))
        frames = np.array(group.frames, np.int32)[number]
        yield (
            (point + count).astype(np.int32),
            frames,
            group.image_points[point, number],
            group.residual[point, number],
        )
        count += len(group.positions)
