"""The way of a camera that reads row after row: readout and path, found in turn."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.self_calibration import undistort_points
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.mapping.solution import PathSolution, Piece
from tisfm.reconstruction.rolling_shutter.readout import ReadoutEstimate, estimate_readout
from tisfm.reconstruction.rolling_shutter.unrolled_tracks import TrackUnroller
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View
from tisfm.shutter import Rolling, rates_of

# Values without a stated source were set by hand.

# Standard deviations from 0: a readout time that is nearer to 0 is dropped.
MIN_SIGNIFICANCE = 4.0
# Intervals between frames: a frame is read before the next one begins.
MAX_READOUT = 1.0
# Rounds of path and readout time.
MAX_ROUNDS = 4
# Intervals: with a smaller change, the rounds end.
MIN_CHANGE = 0.02
# Rounds of a path whose readout time is known.
KNOWN_ROUNDS = 2
# A path that was found with too small a readout time hides a part of the rest: the share of each
# change that is expected to come again, at most.
MAX_HIDDEN_SHARE = 0.6

Near = Callable[[Sequence[View], Sequence[Observations], Sequence[Piece]], PathSolution]


def find_unrolled_path(
    way: PathSolution,
    near: Near,
    matches: Mapping[tuple[int, int], np.ndarray],
    instants: np.ndarray,
    readout: float | None,
    shape: tuple[int, int],
) -> tuple[PathSolution, Rolling | None]:
    """Return the way of middle rows, and how frames moved while they were read.

    If all rows seem to be read at once, it is the way as it was, and None.

    Parameters
    ----------
    way : PathSolution
        Found as if all rows were read at once.
    near : callable
        Returns the way through other views and tracks, which are what a pinhole sees, near those
        of pieces.
    matches : mapping of (int, int) to (N, 2) int array
        For pairs of indices of views: indices of their detected points that are the same.
    instants : (N,) array
        When each frame was taken, in intervals between frames of the source.
    readout : float or None
        If it is known.
    shape : (int, int)
        Height and width of the frames, px.
    """
    camera = way.camera.pinhole()
    views = DiskCache(View.arrays, View.of_arrays)
    for view in way.views:
        detected = undistort_points(view.detected, way.camera, shape)
        views.append(View(frame=view.frame, seen=way.seen[view.frame], detected=detected))
    found, rolling = way, None
    value, deviation, change = readout or 0.0, 0.0, 0.0
    for number in range(MAX_ROUNDS if readout is None else KNOWN_ROUNDS):
        if readout is None:
            estimate = _estimate(found, views, matches, instants, camera, shape, begun=value)
            if estimate is None or not _is_seen(estimate):
                break
            before, change = change, estimate.readout - value
            if number and abs(change) < MIN_CHANGE:
                break
            hidden = min(max(change / before, 0.0), MAX_HIDDEN_SHARE) if before else 0.0
            value, last = _taken(value + change / (1 - hidden)), value
            deviation = float(f"{estimate.deviation:.3g}")
            if number and value == last:  # it is as much as it can be
                break
        unrolling = TrackUnroller(way.seen, found.pieces, instants, value, deviation, camera, shape)
        rolling = unrolling.rolling
        corrected = DiskCache(View.arrays, View.of_arrays)
        for view in views:
            corrected.append(unrolling.view(view))
        found = near(corrected, unrolling.all_tracks(), found.pieces)
        if not found.pieces:
            return way, None
    return found, rolling


def _is_seen(estimate: ReadoutEstimate) -> bool:
    """Return whether a readout differs from 0, and is none that no camera has.

    Of a deviation by which none that a camera has would differ from 0, nothing is believed.
    """
    least = MIN_SIGNIFICANCE * estimate.deviation
    return least < MAX_READOUT and least < abs(estimate.readout) < MAX_READOUT + least


def _taken(readout: float) -> float:
    """Return a readout as it is taken: whole thousandths, so that no rounding gets further."""
    return round(min(max(readout, -MAX_READOUT), MAX_READOUT), 3)


def _estimate(
    way: PathSolution,
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    instants: np.ndarray,
    camera: Camera,
    shape: tuple[int, int],
    *,
    begun: float,
) -> ReadoutEstimate | None:
    """Return the readout that the largest piece shows."""
    if not way.pieces:
        return None
    largest = max(way.pieces, key=lambda piece: len(piece.views))
    rates = rates_of(largest.poses, instants)
    return estimate_readout(views, matches, largest.poses, rates, camera, shape, begun=begun)
