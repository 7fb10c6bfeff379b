"""The camera path of an endless sequence: old poses are final, and new poses continue them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.self_calibration import find_models_and_focal
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.frame_flow import TRACKING_SETTINGS
from tisfm.reconstruction.mapping.models import continue_model, find_models, readjust_models
from tisfm.reconstruction.mapping.solution import (
    MAX_USEFUL_DEVIATION,
    FocalEstimate,
    PathSolution,
    Piece,
)
from tisfm.reconstruction.path.path_solver import add_other_frames, status_of_lost
from tisfm.reconstruction.rolling_shutter.correction import (
    KNOWN_ROUNDS,
    TrackUnroller,
    find_unrolled_path,
)
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.views import View, ViewSelection
from tisfm.shutter import Rolling, instants_of
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
    held: dict[int, np.ndarray]  # dict of int to (4, 4) float64: fixed poses, by frame
    lost: dict[int, Status]  # reason for each frame that is not settled yet and has no pose
    # With a rolling shutter: the motion of unsettled frames while their rows were read. Poses and
    # points are those of middle rows then.
    rolling: Rolling | None = None


class RecentObservations(Sequence[Observations]):
    """Tracks of the recent frames of a sequence; tracks of early frames are dropped."""

    def __init__(self) -> None:
        self._seen: dict[int, Observations] = {}
        self._count = 0

    def append(self, seen: Observations) -> None:
        """Add the next frame."""
        self._seen[self._count] = seen
        self._count += 1

    def frames(self) -> list[int]:
        """Return the frames that are kept."""
        return list(self._seen)

    def forget(self, frame: int) -> None:
        """Drop a frame."""
        del self._seen[frame]

    def changed(self, others: Mapping[int, Observations]) -> "RecentObservations":
        """Return a copy with other tracks in some frames."""
        changed = RecentObservations()
        changed._seen = {frame: others.get(frame, seen) for frame, seen in self._seen.items()}
        changed._count = self._count
        return changed

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, frame: int) -> Observations:  # type: ignore[override]
        return self._seen[frame]

    def __iter__(self) -> Iterator[Observations]:
        return iter(self._seen.values())


class SlidingPath:
    """Finds the camera path of an endless sequence, frame by frame.

    Settled poses are final. The path of later frames continues the last views with settled poses:
    so it has the same axes and scale.

    Parameters
    ----------
    camera : Camera
        Pinhole camera of the frames.
    focal_known : bool
        Whether the focal length is known. Otherwise it is a guess: it is estimated with the first
        path, and then fixed.
    readout : float or None
        Readout time, as in `tisfm.Camera`; None if it is estimated with the first path, and then
        fixed.
    limit : float
        Share of the focal length: if the standard deviation of the estimate is larger, the guess is
        used.
    is_guess : bool
        Whether the focal length is a guess that is not estimated. Then a path does not begin where
        all points lie in one plane.

    Attributes
    ----------
    camera : Camera
    focal : FocalEstimate or None
        The estimate, if the focal length was to be estimated and a path was found.
    readout : float or None
        The current value; 0 after a first path that does not show the readout.
    readout_deviation : float
        Standard deviation of the readout; 0 if the readout was given.
    seen : RecentObservations
        Tracks in the recent frames, as a global shutter would see them.
    settled : int
        The last frame with a final result, with or without a pose; −1 before the first.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        focal_known: bool = True,
        readout: float | None = 0.0,
        limit: float = MAX_USEFUL_DEVIATION,
        is_guess: bool = False,
    ) -> None:
        self.camera = camera
        self.focal: FocalEstimate | None = None
        self.readout, self.readout_deviation = readout, 0.0
        self._focal_known, self._limit = focal_known, limit
        self._focal_stated = focal_known and not is_guess
        self.seen = RecentObservations()
        self._read = RecentObservations()  # tracks not corrected for the readout
        self._unrolled: dict[int, View] = {}
        self._taken: dict[int, tuple[int, float | None]] = {}  # index and time, by frame
        self.settled = -1
        self._tracker = Tracker(camera, TRACKING_SETTINGS)
        self._views = ViewSelection(camera, focal_known=focal_known)
        self._last: tuple[np.ndarray, np.ndarray | None]
        self._shape = (0, 0)
        self._held: dict[int, dict[int, np.ndarray]] = {}  # fixed poses, by piece and frame
        self._pieces = 0

    def add(
        self,
        grey: np.ndarray,  # (H, W) uint8
        ignored: np.ndarray | None = None,  # (H, W) bool: pixels to ignore
        *,
        # (int, float or None): number of the frame in the source, and its time, s; by default the
        # next number and no time
        taken: tuple[int, float | None] | None = None,
    ) -> None:
        """Track and keep the next frame."""
        seen = self._tracker.track(grey, ignored)
        if self._views.needs(seen, max(grey.shape)):
            self._views.add(len(self.seen), grey, seen, ignored)
        self._taken[len(self.seen)] = taken or (len(self.seen), None)
        self.seen.append(seen)
        self._read.append(seen)
        self._last = grey, ignored

    def found(self, *, at_end: bool = False) -> SlidingSolution:
        """Return the path of the recent frames; with `at_end`, no later frame follows."""
        views, (grey, ignored) = self._views, self._last
        self._shape = grey.shape
        last, different = len(self.seen) - 1, len(views.chosen)
        if at_end and (not views.chosen or views.chosen[-1].frame != last):
            views.add(last, grey, self.seen[last], ignored)
        views.close_loops(self._shape)
        solved = self._through(different)
        if self.readout is None and solved.pieces:
            self._find_readout(solved)
        if not self.readout:
            return solved
        for _ in range(KNOWN_ROUNDS):
            rolling = self._unroll(solved)
            solved = replace(self._through(different), rolling=rolling)
        return solved

    def _through(self, different: int) -> SlidingSolution:
        """Return the path for the current views and tracks."""
        views = self._views
        settled = {frame for poses in self._held.values() for frame in poses}
        left = [k for k, view in enumerate(views.chosen) if view.frame not in settled]
        pieces: dict[int, Piece] = {}
        for number in sorted(self._held, key=lambda one: -max(self._held[one])):
            held = self._held[number]
            known = [k for k, view in enumerate(views.chosen) if view.frame in held]
            model = continue_model(
                *self._among(sorted(known + left)), self.camera, self._shape, held
            )
            poses = dict(sorted({**model.poses, **held}.items()))
            pieces[number] = Piece(poses=poses, views=tuple(model.poses), points=model.points)
            left = [k for k in left if views.chosen[k].frame not in model.poses]
        among = self._among(left)
        if self._focal_known:
            models = find_models(*among, self.camera, self._shape, focal_known=self._focal_stated)
        else:
            models, self.focal = find_models_and_focal(
                *among, self.camera, self._shape, "focal", limit=self._limit
            )
            if self.focal is not None:  # from now on it is fixed
                self.camera, self._focal_known = self.focal.taken(self.camera), True
                views.use(self.camera)
        for model in sorted(models, key=lambda one: min(one.poses)):
            number = max([*pieces, self._pieces - 1]) + 1
            pieces[number] = Piece(poses=model.poses, views=tuple(model.poses), points=model.points)
        later = [frame for frame in self.seen.frames() if frame > self.settled]
        complete, unplaced = add_other_frames(
            list(pieces.values()), self.seen, later, self.camera, self._shape
        )
        lost = {
            frame: status_of_lost(
                self.seen[frame], complete, different, focal_known=self._focal_stated
            )
            for frame in unplaced
        }
        return SlidingSolution(
            pieces=dict(zip(pieces, complete, strict=True)),
            held={frame: pose for poses in self._held.values() for frame, pose in poses.items()},
            lost=lost,
        )

    def settle(self, last: int, pieces: Mapping[int, Piece]) -> None:
        """Fix the poses of the frames up to `last` at their values in these pieces."""
        self.settled = last
        for number, piece in pieces.items():
            if min(piece.poses) > last:
                continue
            held = {frame: pose for frame, pose in piece.poses.items() if frame <= last}
            missing = MIN_FIXED_VIEWS - sum(frame in held for frame in piece.views)
            later = [frame for frame in sorted(piece.views) if frame > last]
            held.update({frame: piece.poses[frame] for frame in later[: max(0, missing)]})
            self._held[number] = held
            self._pieces = max(self._pieces, number + 1)

    @property
    def pieces(self) -> set[int]:
        """The pieces that can be continued."""
        return set(self._held)

    def forget(self, before: int, *, kept: set[int]) -> list[int]:
        """Drop the frames before a frame, except `kept`; return the dropped frames."""
        views = self._views
        frames = [view.frame for view in views.chosen]
        settled = sum(frame <= self.settled for frame in frames)
        views.forget(max(0, settled - FIXED_VIEWS))
        of_views = {view.frame for view in views.chosen}
        gone = [frame for frame in self.seen.frames() if frame < before and frame not in kept]
        for frame in gone:
            self.seen.forget(frame)
            self._read.forget(frame)
        there = of_views.union(self.seen.frames())
        self._taken = {frame: self._taken[frame] for frame in sorted(there)}
        self._unrolled = {f: view for f, view in self._unrolled.items() if f in of_views}
        for number, held in list(self._held.items()):
            self._held[number] = {frame: pose for frame, pose in held.items() if frame in there}
            if sum(frame in held for frame in of_views) < 2:
                del self._held[number]
        return gone

    def _among(
        self, numbers: Sequence[int]
    ) -> tuple[list[View], dict[tuple[int, int], np.ndarray]]:
        """Return some of the views, and their matches."""
        place = {number: k for k, number in enumerate(numbers)}
        matches = {
            (place[earlier], place[later]): both
            for (earlier, later), both in self._views.matches.items()
            if earlier in place and later in place
        }
        chosen = [self._views.chosen[number] for number in numbers]
        return [self._unrolled.get(view.frame, view) for view in chosen], matches

    def _find_readout(self, solved: SlidingSolution) -> None:
        """Estimate the readout time with the first path; an insignificant one counts as 0."""
        views, camera, shape = list(self._views.chosen), self.camera.pinhole(), self._shape
        matches = self._views.matches
        tracks = DiskCache(
            Observations.arrays, Observations.of_arrays
        )  # of all frames; dropped frames have no tracks
        there, none = (
            set(self._read.frames()),
            Observations.of_arrays(np.empty((0, 2)), np.empty(0, np.int64)),
        )
        for frame in range(len(self._read)):
            tracks.append(self._read[frame] if frame in there else none)

        def near(
            views: Sequence[View], seen: Sequence[Observations], before: Sequence[Piece]
        ) -> PathSolution:
            known = [{frame: piece.poses[frame] for frame in piece.views} for piece in before]
            models = readjust_models(views, matches, camera, shape, known)
            pieces, unplaced = add_other_frames(
                [Piece(poses=m.poses, views=tuple(m.poses), points=m.points) for m in models],
                seen,
                sorted(there),
                camera,
                shape,
            )
            return replace(solution, pieces=pieces, unplaced=unplaced, views=views, seen=seen)

        solution = PathSolution(
            pieces=list(solved.pieces.values()),
            unplaced=list(solved.lost),
            views=views,
            seen=tracks,
            camera=camera,
            focal=None,
            score=0.0,
        )
        instants = np.zeros(len(self._read))
        for frame, instant in self._instants().items():
            instants[frame] = instant
        _, rolling = find_unrolled_path(solution, near, matches, instants, None, shape)
        self.readout = 0.0 if rolling is None else rolling.readout
        self.readout_deviation = 0.0 if rolling is None else rolling.deviation

    def _unroll(self, solved: SlidingSolution) -> Rolling:
        """Correct unsettled views and tracks for the readout time, with the motion along a path."""
        views = self._views.chosen
        read = {view.frame: view.seen for view in views}
        read |= {frame: self._read[frame] for frame in self._read.frames()}
        unrolling = TrackUnroller(
            read,
            list(solved.pieces.values()),
            self._instants(),
            self.readout or 0.0,
            self.readout_deviation,
            self.camera,
            self._shape,
        )
        new = [frame for frame in self._read.frames() if frame > self.settled]
        self.seen = self.seen.changed({frame: unrolling.tracks(frame) for frame in new})
        for view in views:
            if view.frame > self.settled:
                self._unrolled[view.frame] = unrolling.view(view)
        whole = unrolling.rolling
        return replace(
            whole,
            rates={frame: rate for frame, rate in whole.rates.items() if frame > self.settled},
        )

    def _instants(self) -> dict[int, float]:
        """Return the times of the recent frames, in intervals between frames of the source."""
        numbers, times = zip(*self._taken.values(), strict=True)
        return dict(zip(self._taken, map(float, instants_of(numbers, times)), strict=True))
