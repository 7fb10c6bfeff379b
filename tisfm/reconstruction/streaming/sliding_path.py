"""The camera path of an endless sequence: old poses are final, and new poses continue them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS
from tisfm.reconstruction.mapping.models import continue_model
from tisfm.reconstruction.mapping.solution import FocalEstimate, PathSolution, Piece
from tisfm.reconstruction.path.path_solver import PathSolver, make_piece
from tisfm.reconstruction.rolling_shutter.correction import ReadoutCorrection, find_corrected_path
from tisfm.reconstruction.rolling_shutter.settings import ROLLING_SHUTTER
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.views import View, ViewSelection
from tisfm.shutter import RollingShutterMotion, frame_instants
from tisfm.status import Status

# Values without a stated source were set by hand.

# Number of last views with fixed poses, from which the path is continued.
FIXED_VIEWS = 16
# Smallest number of fixed views of a piece: if fewer are fixed, the poses of later views are fixed
# too.
MIN_FIXED_VIEWS = 6


@dataclass(frozen=True, kw_only=True)
class SlidingSolution:
    """The path of the recent frames."""

    pieces: dict[int, Piece]  # pieces by their numbers, which never change
    fixed_poses: dict[int, np.ndarray]  # (4, 4) float64: fixed poses, by frame
    # reason for each frame without a pose, after the last fixed frame
    missing: Mapping[int, Status]
    # With a rolling shutter: the motion, while rows were read, of frames that are not fixed. Poses
    # and points are then those of middle rows.
    rolling: RollingShutterMotion | None = None


class RecentObservations(Sequence[Observations]):
    """Tracks of the recent frames of a sequence; tracks of earlier frames are dropped."""

    def __init__(self, by_frame: Mapping[int, Observations] | None = None, count: int = 0) -> None:
        self._by_frame, self._count = dict(by_frame or {}), count

    def append(self, observations: Observations) -> None:
        """Add the next frame."""
        self._by_frame[self._count] = observations
        self._count += 1

    def frames(self) -> list[int]:
        """Return the frames with tracks."""
        return list(self._by_frame)

    def drop(self, frame: int) -> None:
        """Drop the tracks of a frame."""
        del self._by_frame[frame]

    def with_tracks(self, others: Mapping[int, Observations]) -> "RecentObservations":
        """Return a copy with the tracks of `others` in their frames."""
        tracks = {
            frame: others.get(frame, observations) for frame, observations in self._by_frame.items()
        }
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
        # Whether the focal length is fixed from the start. Otherwise it is estimated with the first
        # path, and then fixed.
        is_focal_fixed: bool = True,
        # readout time, in intervals between frames; None if it is estimated with the first path,
        # and then fixed
        readout: float | None = 0.0,
        # largest standard deviation of an estimate that replaces the guess, as a share of the focal
        # length
        max_deviation: float,
        # Whether the focal length is a guess that is not estimated. Then a path does not begin
        # where all points lie in one plane.
        is_focal_guessed: bool = False,
        # frame → (H, W) uint8: recent images, which show why frames have no pose
        grey: Callable[[int], np.ndarray] | None = None,
    ) -> None:
        self.camera = camera
        # the estimate, if the focal length was to be estimated and a path was found
        self.focal: FocalEstimate | None = None
        # Readout time and its standard deviation, in intervals between frames. The readout time is
        # 0 if the first path does not show it. The deviation is 0 if the readout time was given.
        self.readout, self.readout_deviation = readout, 0.0
        self._is_focal_fixed, self._max_deviation = is_focal_fixed, max_deviation
        self._grey = grey
        self._is_focal_reliable = is_focal_fixed and not is_focal_guessed
        self.observations = RecentObservations()  # tracks as a global shutter would see them
        self._uncorrected = RecentObservations()  # tracks not corrected for the readout
        self._corrected_views: dict[int, View] = {}
        self._index_and_time: dict[int, tuple[int, float | None]] = {}  # by frame
        self.last_fixed = -1  # the last frame with a final result, with or without a pose
        self._tracker = Tracker(camera, TRACKING_SETTINGS)
        self._views = ViewSelection(camera, is_focal_known=is_focal_fixed)
        self._last_frame: tuple[np.ndarray, np.ndarray | None]
        self._shape = (0, 0)
        self._fixed_poses: dict[int, dict[int, np.ndarray]] = {}  # fixed poses, by piece and frame
        self._piece_count = 0

    def add(
        self,
        grey: np.ndarray,  # (H, W) uint8
        ignored: np.ndarray | None = None,  # (H, W) bool: pixels to ignore
        *,
        # number of the frame in the source, and its time, s; by default the next number and no time
        index_and_time: tuple[int, float | None] | None = None,
    ) -> None:
        """Track the next frame."""
        number, observations = len(self.observations), self._tracker.track(grey, ignored)
        if self._views.needs_view(observations, max(grey.shape)):
            self._views.add(number, grey, observations, ignored)
        self._index_and_time[number] = index_and_time or (number, None)
        self.observations.append(observations)
        self._uncorrected.append(observations)
        self._last_frame, self._shape = (grey, ignored), grey.shape

    def solve(self, *, at_end: bool = False) -> SlidingSolution:
        """Return the path of the recent frames; `at_end` means that no later frame follows."""
        views, (grey, ignored) = self._views, self._last_frame
        last, distinct_count = len(self.observations) - 1, len(views.views)
        if at_end and (not views.views or views.views[-1].frame != last):
            views.add(last, grey, self.observations[last], ignored)
        views.close_loops(self._shape)
        solution = self._solve(distinct_count)
        if self.readout is None and solution.pieces:
            self._find_readout(solution)
        if not self.readout:
            return solution
        for _ in range(ROLLING_SHUTTER.known_rounds):
            rolling = self._correct_readout(solution)
            solution = replace(self._solve(distinct_count), rolling=rolling)
        return solution

    def _solver(self, frames: Sequence[int], distinct_count: int = 0) -> PathSolver:
        """Return the solver for the recent frames, which finds the poses of some frames."""
        tracks = SequenceTracks(
            observations=self.observations,
            views=self._views.views,
            matches=self._views.matches,
            distinct_count=distinct_count,
            shape=self._shape,
        )
        return PathSolver(
            tracks=tracks,
            camera=self.camera,
            max_deviation=self._max_deviation,
            is_focal_known=self._is_focal_reliable,
            frames=frames,
            grey=self._grey,
        )

    def _solve(self, distinct_count: int) -> SlidingSolution:
        """Return the path for the current views and tracks: continued and new pieces."""
        later = [frame for frame in self.observations.frames() if frame > self.last_fixed]
        solver = self._solver(later, distinct_count)
        pieces, free_views = self._continue_pieces()
        graph = self._view_graph(free_views)
        if self._is_focal_fixed:
            models, _ = solver.find_new_models(*graph, self.camera, "nothing")
        else:
            models, self.focal = solver.find_new_models(*graph, self.camera, "focal")
            if self.focal is not None:  # from now on the focal length is fixed
                self.camera, self._is_focal_fixed = self.focal.apply_to(self.camera), True
                self._views.set_camera(self.camera)
        for model in sorted(models, key=lambda model: min(model.poses)):
            pieces[max([*pieces, self._piece_count - 1]) + 1] = make_piece(model)
        solution = solver.complete_solution(
            list(pieces.values()), self._views.views, self.observations, self.camera
        )
        return SlidingSolution(
            pieces=dict(zip(pieces, solution.pieces, strict=True)),
            fixed_poses={
                frame: pose for poses in self._fixed_poses.values() for frame, pose in poses.items()
            },
            missing=solver.find_missing(solution, are_turns_found=False),
        )

    def select_recent(self, piece: Piece) -> Piece:
        """Return a piece with its recent frames only: data of other frames were dropped."""
        recent = set(self.observations.frames())
        poses = {frame: pose for frame, pose in piece.poses.items() if frame in recent}
        return replace(piece, poses=poses)

    def find_image_cause(self, frames: Sequence[int]) -> Status | None:
        """Return what the images of recent frames show against a path; None for nothing."""
        search = CauseSearch.of_images(self.observations, self.camera, self._shape, self._grey)
        return search.find_image_cause(frames)

    def _continue_pieces(self) -> tuple[dict[int, Piece], list[int]]:
        """Return the pieces with fixed poses, continued, and the indices of the other views."""
        frames = [view.frame for view in self._views.views]
        fixed_frames = {frame for poses in self._fixed_poses.values() for frame in poses}
        free_views = [k for k, frame in enumerate(frames) if frame not in fixed_frames]
        pieces: dict[int, Piece] = {}
        for number in sorted(
            self._fixed_poses, key=lambda piece_number: -max(self._fixed_poses[piece_number])
        ):
            fixed_poses = self._fixed_poses[number]
            fixed_views = [k for k, frame in enumerate(frames) if frame in fixed_poses]
            graph = self._view_graph(sorted(fixed_views + free_views))
            model = continue_model(*graph, self.camera, self._shape, fixed_poses)
            poses = dict(sorted({**model.poses, **fixed_poses}.items()))
            pieces[number] = replace(make_piece(model), poses=poses)
            free_views = [k for k in free_views if frames[k] not in model.poses]
        return pieces, free_views

    def fix_poses(self, last: int, pieces: Mapping[int, Piece]) -> None:
        """Fix the poses of the frames up to `last` at their values in these pieces."""
        self.last_fixed = last
        for number, piece in pieces.items():
            if min(piece.poses) > last:
                continue
            fixed_poses = {frame: pose for frame, pose in piece.poses.items() if frame <= last}
            missing_count = MIN_FIXED_VIEWS - sum(frame in fixed_poses for frame in piece.views)
            later = [frame for frame in sorted(piece.views) if frame > last]
            fixed_poses.update(
                {frame: piece.poses[frame] for frame in later[: max(0, missing_count)]}
            )
            self._fixed_poses[number] = fixed_poses
            self._piece_count = max(self._piece_count, number + 1)

    @property
    def pieces(self) -> set[int]:
        """The pieces that can be continued."""
        return set(self._fixed_poses)

    def drop_before(self, first: int, *, keyframes: set[int]) -> list[int]:
        """Drop the frames before a frame, except keyframes; return the dropped frames."""
        views = self._views
        fixed_count = sum(view.frame <= self.last_fixed for view in views.views)
        views.drop_first(max(0, fixed_count - FIXED_VIEWS))
        view_frames = {view.frame for view in views.views}
        dropped = [
            frame
            for frame in self.observations.frames()
            if frame < first and frame not in keyframes
        ]
        for frame in dropped:
            self.observations.drop(frame)
            self._uncorrected.drop(frame)
        recent = view_frames.union(self.observations.frames())
        self._index_and_time = {frame: self._index_and_time[frame] for frame in sorted(recent)}
        self._corrected_views = {
            frame: view for frame, view in self._corrected_views.items() if frame in view_frames
        }
        for number, fixed_poses in list(self._fixed_poses.items()):
            self._fixed_poses[number] = {
                frame: pose for frame, pose in fixed_poses.items() if frame in recent
            }
            if sum(frame in fixed_poses for frame in view_frames) < 2:
                del self._fixed_poses[number]
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
        return [self._corrected_views.get(view.frame, view) for view in views], matches

    def _find_readout(self, path: SlidingSolution) -> None:
        """Estimate the readout time with the first path; set it to 0 if it is not significant."""
        pinhole, frames = self.camera.pinhole(), sorted(self._uncorrected.frames())
        no_tracks = Observations.from_arrays(np.empty((0, 2)), np.empty(0, np.int64))
        tracks = DiskCache(Observations.to_arrays, Observations.from_arrays)  # of all frames
        for frame in range(len(self._uncorrected)):
            tracks.append(self._uncorrected[frame] if frame in set(frames) else no_tracks)
        solution = PathSolution(
            pieces=list(path.pieces.values()),
            missing_frames=list(path.missing),
            views=list(self._views.views),
            observations=tracks,
            camera=pinhole,
            focal=None,
            score=0.0,
        )
        instants = np.zeros(len(self._uncorrected))
        for frame, instant in self._instants().items():
            instants[frame] = instant
        solver = self._solver(frames)
        resolve = partial(solver.readjust, camera=pinhole)
        matches = self._views.matches
        _, rolling = find_corrected_path(solution, resolve, matches, instants, None, self._shape)
        self.readout = 0.0 if rolling is None else rolling.readout
        self.readout_deviation = 0.0 if rolling is None else rolling.deviation

    def _correct_readout(self, path: SlidingSolution) -> RollingShutterMotion:
        """Correct views and tracks that are not fixed for the readout, with the motion of the path.

        Returns the motion of their frames while the rows were read.
        """
        uncorrected = {view.frame: view.observations for view in self._views.views}
        uncorrected |= {frame: self._uncorrected[frame] for frame in self._uncorrected.frames()}
        correction = ReadoutCorrection(
            uncorrected,
            list(path.pieces.values()),
            self._instants(),
            self.readout or 0.0,
            self.readout_deviation,
            self.camera,
            self._shape,
        )
        later = [frame for frame in self._uncorrected.frames() if frame > self.last_fixed]
        self.observations = self.observations.with_tracks(
            {frame: correction.correct_tracks(frame) for frame in later}
        )
        for view in self._views.views:
            if view.frame > self.last_fixed:
                self._corrected_views[view.frame] = correction.correct_view(view)
        rates = correction.rolling.rates.items()
        return replace(
            correction.rolling,
            rates={frame: rate for frame, rate in rates if frame > self.last_fixed},
        )

    def _instants(self) -> dict[int, float]:
        """Return the times of the recent frames, in intervals between frames of the source."""
        indices, times = zip(*self._index_and_time.values(), strict=True)
        instants = frame_instants(indices, times)
        return dict(zip(self._index_and_time, map(float, instants), strict=True))
