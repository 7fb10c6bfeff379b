"""The points of a frame, as far as thresholds and a box leave them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ViewFrame
from tisfm.view.colors import Quantity, Ranges, pixel_colors

FARTHEST_MEDIANS = 10.0  # depths, as of point clouds: farther depth is a guess


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Which points of a frame are shown.

    Attributes
    ----------
    min_confidence : float
        In [0, 1]; where a result has no confidence, all pixels pass.
    max_deviation : float
        Relative deviation of depth, as a share; infinite for no limit. Where a result has
        deviations, pixels without one are left out below infinity.
    box : ((3,), (3,)) or None
        Least and greatest coordinates, in the world of the scene.
    most_points : int
        Pixels are left out, in a regular grid, until there are at most so many.
    with_hidden : bool
        Whether to show pixels that are not visible in the next frame.
    """

    min_confidence: float = 0.0
    max_deviation: float = float("inf")
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    most_points: int = 200_000
    with_hidden: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """Points of a frame, in the axes of its camera, in the scale of the scene.

    Attributes
    ----------
    positions : (N, 3) float32
        X right, Y down, Z forward.
    colors : (N, 3) uint8
    pixels : (N, 2) int32
        Row and column of each.
    step : int
        Every so many rows and columns were taken.
    size : float
        Of a point, so that neighbours touch at the median depth.
    """

    positions: NDArray[np.float32]
    colors: NDArray[np.uint8]
    pixels: NDArray[np.int32]
    step: int
    size: float

    def __len__(self) -> int:
        return len(self.positions)


def cloud(
    frame: ViewFrame,
    quantity: Quantity,
    ranges: Ranges,
    choice: Choice,
    pose: NDArray[np.float64] | None = None,
) -> Cloud:
    """Return the points of a frame.

    Parameters
    ----------
    frame : ViewFrame
    quantity : str
        What the points are coloured by.
    ranges : Ranges
    choice : Choice
    pose : (4, 4), optional
        Camera to world, for the box; by default the world is that of the camera.
    """
    kept = _passing(frame, choice)
    step = _step(int(kept.sum()), choice.most_points)
    rows, columns = np.nonzero(kept[::step, ::step])
    rows, columns = step * rows, step * columns
    positions = _positions(frame, rows, columns)
    if choice.box is not None and len(positions):
        world = positions if pose is None else positions @ pose[:3, :3].T + pose[:3, 3]
        low, high = choice.box
        inside = ((world >= low) & (world <= high)).all(axis=1)
        rows, columns, positions = rows[inside], columns[inside], positions[inside]
    median = float(np.median(positions[:, 2])) if len(positions) else 1.0
    return Cloud(
        positions=positions,
        colors=pixel_colors(frame, quantity, ranges)[rows, columns],
        pixels=np.stack([rows, columns], axis=-1).astype(np.int32),
        step=step,
        size=step * median / frame.camera.focal,
    )


def _passing(frame: ViewFrame, choice: Choice) -> NDArray[np.bool_]:
    """Return which pixels thresholds leave, (H, W) bool."""
    kept = frame.has_depth
    if frame.hidden is not None and not choice.with_hidden:
        kept &= ~frame.hidden
    if frame.confidence is not None and choice.min_confidence > 0:
        kept &= frame.confidence >= choice.min_confidence
    if frame.relative_deviation is not None and np.isfinite(choice.max_deviation):
        kept &= frame.relative_deviation <= choice.max_deviation  # not so where it is NaN
    if kept.any():
        least = float(np.median(frame.inverse_depth[kept])) / FARTHEST_MEDIANS
        kept &= frame.inverse_depth >= least
    return kept


def _step(count: int, most: int) -> int:
    """Return which rows and columns to take so that about so many of the pixels are left."""
    return max(1, int(np.ceil(np.sqrt(count / max(most, 1)))))


def _positions(
    frame: ViewFrame, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Return where pixels are in the scene, (N, 3), in the axes of the camera."""
    depth = np.float32(frame.scale) / frame.inverse_depth[rows, columns]
    return frame.rays(rows, columns) * depth[:, None]
