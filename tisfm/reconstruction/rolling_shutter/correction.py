"""The path of a rolling-shutter camera: readout time and path are estimated in turn.

Tracks and views are corrected for the readout time: they become those of a global shutter.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.self_calibration import undistort_points
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.mapping.solution import PathSolution, Piece
from tisfm.reconstruction.rolling_shutter.readout import ReadoutEstimate, estimate_readout
from tisfm.reconstruction.rolling_shutter.settings import ROLLING_SHUTTER
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import points_of_tracks
from tisfm.reconstruction.tracks.views import View
from tisfm.shutter import RollingShutterMotion, motion_rates, points_at_middle_row

# The longest readout time, in intervals between frames: the readout of a frame ends before the next
# frame begins.
MAX_READOUT = 1.0

SolvePath = Callable[[Sequence[View], Sequence[Observations], Sequence[Piece]], PathSolution]


class ReadoutCorrection:
    """Moves the points of frames to the positions that a global shutter would see."""

    def __init__(
        self,
        # tracks in every frame, as the camera sees them, not corrected
        observations: Sequence[Observations] | Mapping[int, Observations],
        pieces: Sequence[Piece],  # each frame is in at most one piece
        # (N,) array, or mapping by frame: time of each frame, in intervals between frames of the
        # source
        instants: np.ndarray | Mapping[int, float],
        # readout time and its standard deviation, in intervals between frames
        readout: float,
        deviation: float,
        camera: Camera,  # pinhole camera
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> None:
        self._observations, self._camera, self._shape = observations, camera, shape
        rates: dict[int, np.ndarray] = {}
        inverse_depth: dict[int, float] = {}
        self._depths: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for piece in pieces:
            for frame, rate in motion_rates(piece.poses, instants).items():
                depth, has_depth = _track_depths(
                    observations[frame], piece.points, piece.poses[frame]
                )
                if has_depth.any():
                    rates[frame], inverse_depth[frame] = (
                        rate,
                        1 / float(np.median(depth[has_depth])),
                    )
                    self._depths[frame] = depth, has_depth
        self.rolling = RollingShutterMotion(
            camera=camera,
            readout=readout,
            deviation=deviation,
            rates=rates,
            inverse_depth=inverse_depth,
        )

    def correct_tracks(self, frame: int) -> Observations:
        """Return the corrected tracks of a frame; tracks that leave the frame are dropped."""
        observations = self._observations[frame]
        if frame not in self._depths:
            return observations
        depth, has_depth = self._depths[frame]
        median_depth = 1 / self.rolling.inverse_depth[frame]
        points = self._correct_points(
            frame, observations.points, np.where(has_depth, depth, median_depth)
        )
        height, width = self._shape
        is_inside = ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=1)
        return Observations(points=points[is_inside], tracks=observations.tracks[is_inside])

    def correct_all_tracks(self) -> DiskCache[Observations]:
        """Return the corrected tracks of every frame."""
        corrected = DiskCache(Observations.to_arrays, Observations.from_arrays)
        for frame in range(len(self._observations)):
            corrected.append(self.correct_tracks(frame))
        return corrected

    def correct_view(self, view: View) -> View:
        """Return a view with corrected tracks and detected points.

        The depth of a detected point is the median depth of the nearest tracks.
        """
        frame = view.frame
        if frame not in self._depths or not len(view.detected):
            return replace(view, observations=self.correct_tracks(frame))
        depth, has_depth = self._depths[frame]
        _, neighbours = cKDTree(self._observations[frame].points[has_depth]).query(
            view.detected, k=min(ROLLING_SHUTTER.depth_neighbours, int(has_depth.sum()))
        )
        median_depth = np.median(
            depth[has_depth][neighbours].reshape(len(view.detected), -1), axis=1
        )
        return replace(
            view,
            observations=self.correct_tracks(frame),
            detected=self._correct_points(frame, view.detected, median_depth),
        )

    def _correct_points(self, frame: int, points: np.ndarray, depth: np.ndarray) -> np.ndarray:
        rolling = self.rolling
        return points_at_middle_row(
            points, depth, rolling.rates[frame], rolling.readout, self._camera, self._shape
        )


def _track_depths(
    observations: Observations, points: Mapping[int, np.ndarray], pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth of each track of a frame, (N,), and whether it is known and positive."""
    has_point, world = points_of_tracks(observations, points)
    depth = np.zeros(len(observations.tracks))
    depth[has_point] = (world - pose[:3, 3]) @ pose[:3, 2]
    return depth, depth > 0


def find_corrected_path(
    solution: PathSolution,  # the path that was found for a global shutter
    # returns the path for corrected views and tracks of a pinhole, starting from the poses of
    # pieces
    solve_path: SolvePath,
    # by pair of view indices: (N, 2) int array, the indices of their detected points that match
    matches: Mapping[tuple[int, int], np.ndarray],
    # (N,) array: time of each frame, in intervals between frames of the source
    instants: np.ndarray,
    readout: float | None,  # the readout time; None if it is estimated
    shape: tuple[int, int],  # height and width of the frames, px
) -> tuple[PathSolution, RollingShutterMotion | None]:
    """Return the path of the middle rows, and the motion of frames while their rows were read.

    If no readout time is significant, the given path and None are returned.
    """
    camera = solution.camera.pinhole()
    views = DiskCache(View.to_arrays, View.from_arrays)
    for view in solution.views:
        detected = undistort_points(view.detected, solution.camera, shape)
        views.append(
            View(
                frame=view.frame, observations=solution.observations[view.frame], detected=detected
            )
        )
    corrected_solution, rolling = solution, None
    current_readout, deviation, change = readout or 0.0, 0.0, 0.0
    for round_number in range(
        ROLLING_SHUTTER.max_rounds if readout is None else ROLLING_SHUTTER.known_rounds
    ):
        if readout is None:
            estimate = _estimate_from_largest_piece(
                corrected_solution, views, matches, instants, camera, shape, start=current_readout
            )
            if estimate is None or not _is_significant(estimate):
                break
            previous_change, change = change, estimate.readout - current_readout
            if round_number and abs(change) < ROLLING_SHUTTER.min_change:
                break
            hidden_share = (
                min(max(change / previous_change, 0.0), ROLLING_SHUTTER.max_hidden_share)
                if previous_change
                else 0.0
            )
            current_readout, previous_readout = (
                _round_readout(current_readout + change / (1 - hidden_share)),
                current_readout,
            )
            deviation = float(f"{estimate.deviation:.3g}")
            # The readout time does not change any more if it is at its limit.
            if round_number and current_readout == previous_readout:
                break
        correction = ReadoutCorrection(
            solution.observations,
            corrected_solution.pieces,
            instants,
            current_readout,
            deviation,
            camera,
            shape,
        )
        rolling = correction.rolling
        corrected_views = DiskCache(View.to_arrays, View.from_arrays)
        for view in views:
            corrected_views.append(correction.correct_view(view))
        corrected_solution = solve_path(
            corrected_views, correction.correct_all_tracks(), corrected_solution.pieces
        )
        if not corrected_solution.pieces:
            return solution, None
    return corrected_solution, rolling


def _is_significant(estimate: ReadoutEstimate) -> bool:
    """Return whether a readout time differs significantly from 0 and is possible for a camera.

    With a large standard deviation, no possible value is significant, and the result is False.
    """
    min_readout = ROLLING_SHUTTER.min_significance * estimate.deviation
    return (
        min_readout < MAX_READOUT
        and min_readout < abs(estimate.readout) < MAX_READOUT + min_readout
    )


def _round_readout(readout: float) -> float:
    """Round a readout time to thousandths, so that rounding errors do not spread."""
    return round(min(max(readout, -MAX_READOUT), MAX_READOUT), 3)


def _estimate_from_largest_piece(
    solution: PathSolution,
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    instants: np.ndarray,
    camera: Camera,
    shape: tuple[int, int],
    *,
    start: float,
) -> ReadoutEstimate | None:
    """Estimate the readout time from the largest piece."""
    if not solution.pieces:
        return None
    largest = max(solution.pieces, key=lambda piece: len(piece.views))
    rates = motion_rates(largest.poses, instants)
    return estimate_readout(views, matches, largest.poses, rates, camera, shape, start=start)
