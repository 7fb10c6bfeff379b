"""The camera path of an endless sequence: old poses are final, and new poses continue them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS
from tisfm.reconstruction.mapping.models import continue_model
from tisfm.reconstruction.mapping.solution import FocalEstimate, PathSolution, Piece
from tisfm.reconstruction.path.path_solver import PathSolver, piece_of_model
from tisfm.reconstruction.rolling_shutter.correction import ReadoutCorrection, find_corrected_path
from tisfm.reconstruction.rolling_shutter.settings import ROLLING_SHUTTER
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.views import View, ViewSelection
from tisfm.shutter import RollingShutterMotion, frame_instants
from tisfm.status import Status

# Values without a stated source were set by hand.

# Number of the last views with fixed poses that are kept to continue the path.
FIXED_VIEWS = 16
# The fewest fixed views of a piece: with fewer, the poses of later views are fixed too.
MIN_FIXED_VIEWS = 6


@dataclass(frozen=True, kw_only=True)
class SlidingSolution:
    """The path of the recent frames."""

    pieces: dict[int, Piece]  # pieces by their numbers, which never change
    fixed: dict[int, np.ndarray]  # (4, 4) float64: fixed poses, by frame
    lost: dict[int, Status]  # reason for each frame after the last fixed one without a pose
    # With a rolling shutter: the motion of frames that are not fixed, while their rows were read.
    # Poses and points are those of middle rows then.
    rolling: RollingShutterMotion | None = None


class RecentObservations(Sequence[Observations]):
    """Tracks of the recent frames of a sequence; tracks of early frames are dropped."""

    def __init__(self, by_frame: Mapping[int, Observations] | None = None, count: int = 0) -> None:
        self._by_frame, self._count = dict(by_frame or {}), count

    def append(self, seen: Observations) -> None:
        """Add the next frame."""
        self._by_frame[self._count] = seen
        self._count += 1

    def frames(self) -> list[int]:
        """Return the frames with tracks."""
        return list(self._by_frame)

    def drop(self, frame: int) -> None:
        """Drop the tracks of a frame."""
        del self._by_frame[frame]

    def with_tracks(self, others: Mapping[int, Observations]) -> "RecentObservations":
        """Return a copy with other tracks in some frames."""
        tracks = {frame: others.get(frame, seen) for frame, seen in self._by_frame.items()}
        return RecentObservations(tracks, self._count)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, frame: int) -> Observations:  # type: ignore[override]
        return self._by_frame[frame]

    def __iter__(self) -> Iterator[Observations]:
        return iter(self._by_frame.values())


class SlidingPath:
    """Finds the camera path of an endless sequence, frame by frame.

    `PathSolver` finds the path of the recent frames. The poses of frames that were yielded are
    fixed. The path of later frames continues the last fixed views, so it has the same axes and the
    same scale.
    """

    def __init__(
        self,
        camera: Camera,  # pinhole camera of the frames
        *,
        # Whether the focal length is known. Otherwise it is a guess: it is estimated with the first
        # path, and then fixed.
        is_focal_known: bool = True,
        # Readout time, as in `tisfm.Camera`; None if it is estimated with the first path, and then
        # fixed
        readout: float | None = 0.0,
        # Share of the focal length: with a larger standard deviation of the estimate, the guess is
        # used
        limit: float,
        # Whether the focal length is a guess that is not estimated. Then a path does not begin
        # where all points lie in one plane.
        is_guess: bool = False,
    ) -> None:
        self.camera = camera
        # The estimate, if the focal length was to be estimated and a path was found
        self.focal: FocalEstimate | None = None
        # The current value, 0 after a first path that does not show it; deviation 0 if it was given
        self.readout, self.readout_deviation = readout, 0.0
        self._focal_known, self._limit = is_focal_known, limit
        self._is_focal_stated = is_focal_known and not is_guess
        self.seen = RecentObservations()  # as a global shutter would see the tracks
        self._read = RecentObservations()  # tracks not corrected for the readout
        self._unrolled_views: dict[int, View] = {}
        self._index_and_time: dict[int, tuple[int, float | None]] = {}  # by frame
        self.last_fixed = -1  # the last frame with a final result, with or without a pose
        self._tracker = Tracker(camera, TRACKING_SETTINGS)
        self._views = ViewSelection(camera, is_focal_known=is_focal_known)
        self._last_frame: tuple[np.ndarray, np.ndarray | None]
        self._shape = (0, 0)
        self._fixed: dict[int, dict[int, np.ndarray]] = {}  # fixed poses, by piece and frame
        self._piece_count = 0

    def add(
        self,
        grey: np.ndarray,  # (H, W) uint8
        ignored: np.ndarray | None = None,  # (H, W) bool: pixels to ignore
        *,
        # Number of the frame in the source, and its time, s; by default the next number and no time
        index_and_time: tuple[int, float | None] | None = None,
    ) -> None:
        """Track the next frame."""
        number, seen = len(self.seen), self._tracker.track(grey, ignored)
        if self._views.needs_view(seen, max(grey.shape)):
            self._views.add(number, grey, seen, ignored)
        self._index_and_time[number] = index_and_time or (number, None)
        self.seen.append(seen)
        self._read.append(seen)
        self._last_frame, self._shape = (grey, ignored), grey.shape

    def solve(self, *, at_end: bool = False) -> SlidingSolution:
        """Return the path of the recent frames; with `at_end`, no later frame follows."""
        views, (grey, ignored) = self._views, self._last_frame
        last, distinct_count = len(self.seen) - 1, len(views.views)
        if at_end and (not views.views or views.views[-1].frame != last):
            views.add(last, grey, self.seen[last], ignored)
        views.close_loops(self._shape)
        solution = self._solve(distinct_count)
        if self.readout is None and solution.pieces:
            self._find_readout(solution)
        if not self.readout:
            return solution
        for _ in range(ROLLING_SHUTTER.known_rounds):
            rolling = self._unroll(solution)
            solution = replace(self._solve(distinct_count), rolling=rolling)
        return solution

    def _solver(self, frames: Sequence[int], distinct_count: int = 0) -> PathSolver:
        """Return the solver for the recent frames; it gives poses to some of them."""
        tracks = SequenceTracks(
            observations=self.seen,
            views=self._views.views,
            matches=self._views.matches,
            distinct_count=distinct_count,
            shape=self._shape,
        )
        return PathSolver(
            tracks=tracks,
            camera=self.camera,
            max_deviation=self._limit,
            is_focal_known=self._is_focal_stated,
            frames=frames,
        )

    def _solve(self, distinct_count: int) -> SlidingSolution:
        """Return the path for the current views and tracks: continued and new pieces."""
        later = [frame for frame in self.seen.frames() if frame > self.last_fixed]
        solver = self._solver(later, distinct_count)
        pieces, free = self._continue_pieces()
        graph = self._view_graph(free)
        if self._focal_known:
            models, _ = solver.find_new_models(*graph, self.camera, "nothing")
        else:
            models, self.focal = solver.find_new_models(*graph, self.camera, "focal")
            if self.focal is not None:  # from now on it is fixed
                self.camera, self._focal_known = self.focal.apply_to(self.camera), True
                self._views.set_camera(self.camera)
        for model in sorted(models, key=lambda model: min(model.poses)):
            pieces[max([*pieces, self._piece_count - 1]) + 1] = piece_of_model(model)
        solution = solver.complete_solution(
            list(pieces.values()), self._views.views, self.seen, self.camera
        )
        return SlidingSolution(
            pieces=dict(zip(pieces, solution.pieces, strict=True)),
            fixed={frame: pose for poses in self._fixed.values() for frame, pose in poses.items()},
            lost=solver.find_missing(solution),
        )

    def _continue_pieces(self) -> tuple[dict[int, Piece], list[int]]:
        """Return the pieces with fixed poses, continued, and the indices of the other views."""
        frames = [view.frame for view in self._views.views]
        fixed_frames = {frame for poses in self._fixed.values() for frame in poses}
        free = [k for k, frame in enumerate(frames) if frame not in fixed_frames]
        pieces: dict[int, Piece] = {}
        for number in sorted(self._fixed, key=lambda one: -max(self._fixed[one])):
            fixed = self._fixed[number]
            known = [k for k, frame in enumerate(frames) if frame in fixed]
            graph = self._view_graph(sorted(known + free))
            model = continue_model(*graph, self.camera, self._shape, fixed)
            poses = dict(sorted({**model.poses, **fixed}.items()))
            pieces[number] = replace(piece_of_model(model), poses=poses)
            free = [k for k in free if frames[k] not in model.poses]
        return pieces, free

    def fix_poses(self, last: int, pieces: Mapping[int, Piece]) -> None:
        """Fix the poses of the frames up to `last` at their values in these pieces."""
        self.last_fixed = last
        for number, piece in pieces.items():
            if min(piece.poses) > last:
                continue
            fixed = {frame: pose for frame, pose in piece.poses.items() if frame <= last}
            missing = MIN_FIXED_VIEWS - sum(frame in fixed for frame in piece.views)
            later = [frame for frame in sorted(piece.views) if frame > last]
            fixed.update({frame: piece.poses[frame] for frame in later[: max(0, missing)]})
            self._fixed[number] = fixed
            self._piece_count = max(self._piece_count, number + 1)

    @property
    def pieces(self) -> set[int]:
        """The pieces that can be continued."""
        return set(self._fixed)

    def drop_before(self, first: int, *, keyframes: set[int]) -> list[int]:
        """Drop the frames before a frame, except keyframes; return the dropped frames."""
        views = self._views
        fixed_count = sum(view.frame <= self.last_fixed for view in views.views)
        views.drop_first(max(0, fixed_count - FIXED_VIEWS))
        view_frames = {view.frame for view in views.views}
        dropped = [f for f in self.seen.frames() if f < first and f not in keyframes]
        for frame in dropped:
            self.seen.drop(frame)
            self._read.drop(frame)
        recent = view_frames.union(self.seen.frames())
        self._index_and_time = {frame: self._index_and_time[frame] for frame in sorted(recent)}
        self._unrolled_views = {
            frame: view for frame, view in self._unrolled_views.items() if frame in view_frames
        }
        for number, fixed in list(self._fixed.items()):
            self._fixed[number] = {frame: pose for frame, pose in fixed.items() if frame in recent}
            if sum(frame in fixed for frame in view_frames) < 2:
                del self._fixed[number]
        return dropped

    def _view_graph(
        self, indices: Sequence[int]
    ) -> tuple[list[View], dict[tuple[int, int], np.ndarray]]:
        """Return some of the views, by their indices, and their matches."""
        position = {index: k for k, index in enumerate(indices)}
        matches = {
            (position[earlier], position[later]): pairs
            for (earlier, later), pairs in self._views.matches.items()
            if earlier in position and later in position
        }
        views = [self._views.views[index] for index in indices]
        return [self._unrolled_views.get(view.frame, view) for view in views], matches

    def _find_readout(self, path: SlidingSolution) -> None:
        """Estimate the readout time with the first path; an insignificant one counts as 0."""
        pinhole, frames = self.camera.pinhole(), sorted(self._read.frames())
        no_tracks = Observations.from_arrays(np.empty((0, 2)), np.empty(0, np.int64))
        tracks = DiskCache(Observations.to_arrays, Observations.from_arrays)  # of all frames
        for frame in range(len(self._read)):
            tracks.append(self._read[frame] if frame in set(frames) else no_tracks)
        solution = PathSolution(
            pieces=list(path.pieces.values()),
            missing_frames=list(path.lost),
            views=list(self._views.views),
            observations=tracks,
            camera=pinhole,
            focal=None,
            score=0.0,
        )
        instants = np.zeros(len(self._read))
        for frame, instant in self._instants().items():
            instants[frame] = instant
        solver = self._solver(frames)
        resolve = partial(solver.readjust, camera=pinhole)
        matches = self._views.matches
        _, rolling = find_corrected_path(solution, resolve, matches, instants, None, self._shape)
        self.readout = 0.0 if rolling is None else rolling.readout
        self.readout_deviation = 0.0 if rolling is None else rolling.deviation

    def _unroll(self, path: SlidingSolution) -> RollingShutterMotion:
        """Correct the views and tracks that are not fixed for the readout, with the path's motion.

        Returns the motion of their frames while the rows were read.
        """
        read = {view.frame: view.observations for view in self._views.views}
        read |= {frame: self._read[frame] for frame in self._read.frames()}
        unroller = ReadoutCorrection(
            read,
            list(path.pieces.values()),
            self._instants(),
            self.readout or 0.0,
            self.readout_deviation,
            self.camera,
            self._shape,
        )
        later = [frame for frame in self._read.frames() if frame > self.last_fixed]
        self.seen = self.seen.with_tracks(
            {frame: unroller.correct_tracks(frame) for frame in later}
        )
        for view in self._views.views:
            if view.frame > self.last_fixed:
                self._unrolled_views[view.frame] = unroller.correct_view(view)
        rates = unroller.rolling.rates.items()
        return replace(
            unroller.rolling,
            rates={frame: rate for frame, rate in rates if frame > self.last_fixed},
        )

    def _instants(self) -> dict[int, float]:
        """Return the times of the recent frames, in intervals between frames of the source."""
        indices, times = zip(*self._index_and_time.values(), strict=True)
        instants = frame_instants(indices, times)
        return dict(zip(self._index_and_time, map(float, instants), strict=True))
