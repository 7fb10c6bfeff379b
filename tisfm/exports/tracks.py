"""Tracks of points through the frames of a reconstruction, measured in the images."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.checks import Floats
from tisfm.errors import InputError
from tisfm.exports.depth_tracks import DepthTracks
from tisfm.exports.flow_tracks import along_motion
from tisfm.exports.track_frames import PieceFrames, SeenPoints
from tisfm.reconstruction.result.reconstruction import Reconstruction

CELLS = 80  # along the longer side: a point is begun in every cell that has none


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """Points of one piece, and where frames see them.

    Attributes
    ----------
    positions : (P, 3) float64
        In the world, in the unit of the poses.
    colors : (P, 3) uint8
        Red, green, blue.
    points : (O,) int32
        Of every observation: which point is seen. Observations of one point follow one another.
    frames : (O,) int32
        In which frame.
    places : (O, 2) float64
        Where: (x, y), px from the upper left pixel's centre, measured in the images.
    residual : (O,) float64
        How far that is from where the pose and the position say, px.
    """

    positions: Floats
    colors: np.ndarray
    points: np.ndarray
    frames: np.ndarray
    places: Floats
    residual: Floats

    def __len__(self) -> int:
        return len(self.positions)


def measured_tracks(
    result: Reconstruction,
    piece: int,
    *,
    spacing: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Tracks:
    """Return tracks of points that stand out, through the frames of a piece.

    A point is begun in a keyframe, at a corner whose depth is known; depth and poses lead to other
    frames, and there its position is measured in the images. It is kept where three frames or more
    agree on one point in space, within 1.5 px of each. What moves on its own, and masked pixels,
    have no points. Where no frame has depth, points are carried along the image motion.

    Parameters
    ----------
    result : Reconstruction
    piece : int
    spacing : float, optional
        Between points that are begun in a frame, px; by default 1/80 of the longer side.
    progress : callable, optional
        Called with the number of frames that are done, and of those there are.

    Raises
    ------
    ValueError
        If there is no such piece, or the spacing is not positive.
    FileNotFoundError, tisfm.formats.FormatError
        If files of the reconstruction are missing or damaged.
    """
    if not 0 <= piece < len(result.unit):
        raise InputError(f"piece is {piece}: expected 0 to {len(result.unit) - 1}")
    told = progress or _untold
    frames, cells = PieceFrames(result, piece), cells_of(result.shape, spacing)
    if not any(map(frames.has_depth, frames.numbers)):
        return _joined(along_motion(frames, cells, told))
    found = DepthTracks(frames, cells).found(told)
    if not any(len(one.positions) for one in found):  # there is depth, but none that leads on
        found = along_motion(frames, cells, _untold)  # all frames are said to be done
    return _joined(found)


def _untold(done: int, count: int) -> None:
    """Tell nobody how far it is."""


def cells_of(shape: tuple[int, int], spacing: float | None) -> int:
    """Return how many cells there are along the longer side of frames.

    Raises
    ------
    ValueError
        If the spacing is not a positive number of px.
    """
    if spacing is None:
        return CELLS
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing is {spacing}: expected a positive number of px")
    return max(1, round(max(shape) / spacing))


def _joined(found: Sequence[SeenPoints]) -> Tracks:
    """Return the points of all, numbered throughout."""
    observed = list(_observations(found))
    points, frames, places, residual = (
        np.concatenate([empty, *(one[k] for one in observed)])
        for k, empty in enumerate(
            (np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 2)), np.empty(0))
        )
    )
    return Tracks(
        positions=np.vstack([np.empty((0, 3)), *(one.positions for one in found)]),
        colors=np.vstack([np.empty((0, 3), np.uint8), *(one.colors for one in found)]),
        points=points,
        frames=frames,
        places=places,
        residual=residual,
    )


def _observations(found: Sequence[SeenPoints]) -> Iterator[tuple[np.ndarray, ...]]:
    """Give points, frames, places and residuals of what was seen, point by point."""
    begun = 0
    for one in found:
        point, number = np.nonzero(np.isfinite(one.places[..., 0]))
        frames = np.array(one.frames, np.int32)[number]
        yield (
            (point + begun).astype(np.int32),
            frames,
            one.places[point, number],
            one.residual[point, number],
        )
        begun += len(one.positions)
