"""A stream: reads and tracks frames, solves the path, finds depth, yields and drops frames."""

import warnings
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.reconstruction.calibration.source_camera import (
    SourceCamera,
)
from tisfm.reconstruction.depth.pose_adjustment import adjust_poses
from tisfm.reconstruction.depth.segment_depth import (
    MAX_FRAME_DISTANCE,
    FrameDepth,
    PieceDepths,
    depth_effort,
    median_depth,
)
from tisfm.reconstruction.depth.window_depth import WindowDepth
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.pipeline import NO_PARALLAX, add_piece_note
from tisfm.reconstruction.result.calibration import GIVEN, Calibrate
from tisfm.reconstruction.result.folder import CACHE, PICTURES, read_picture
from tisfm.reconstruction.streaming.sliding_path import SlidingPath, SlidingSolution
from tisfm.reconstruction.streaming.streamed_frame import StreamedFrame
from tisfm.reconstruction.tracks.triangulation import track_depths
from tisfm.settings import Settings
from tisfm.sources import FrameSource, SourceFrame
from tisfm.sources.frame_reader import warn_notes
from tisfm.status import Status
from tisfm.trajectory.times import time_fault

# The delay divided by this number: number of the last frames that help to find the path, but are
# yielded in a later call.
LOOKAHEAD_DIVISOR = 3


class Stream:
    """Reads frames, and yields each with its pose and depth."""

    def __init__(
        self,
        source: FrameSource,
        # camera of the source's frames, or its file; None for a guess
        camera: Camera | Path | None,
        calibrate: Calibrate,  # the part of the camera that is estimated with the first path
        settings: Settings,
        delay: int,  # the largest number of later frames that are read before a frame is yielded
    ) -> None:
        self._source, self._camera, self._settings = source, camera, settings
        self._calibrate, self._calibration = calibrate, GIVEN
        self._source_camera: SourceCamera
        self._delay, self._effort = delay, depth_effort(settings)
        self._folder = Path()
        self._frames: PreparedFrames
        self._path: SlidingPath
        self._about: dict[int, tuple[int, str, float | None]] = {}  # index, name and time, by frame
        self._keys: dict[int, tuple[int, WindowDepth]] = {}  # last keyframe of each piece
        self._begun: set[int] = set()  # pieces with yielded frames
        self._told = 0
        self._notes: list[str] = list(source.notes)  # notes without a warning yet
        self._have_times_fault = False

    def frames(self) -> Iterator[StreamedFrame]:
        """Yield every frame in order; an error of the source follows the frames before it."""
        fault: Exception | None = None
        count = 0
        with (
            TemporaryDirectory(prefix="tisfm-") as folder,
            closing(self._source.frames()) as incoming,
        ):
            self._folder = Path(folder)
            while fault is None:
                try:
                    frame = next(incoming, None)
                    if frame is None:
                        break
                    self._add(frame, count)
                except Exception as error:
                    fault = error
                    break
                finally:
                    self._warn_of_skipped()
                    warn_notes(self._notes, stacklevel=4)
                    self._notes.clear()
                del frame  # so that its memory is free while frames are yielded
                count += 1
                if len(self._about) > self._delay:
                    yield from self._given(count - 1 - self._delay // LOOKAHEAD_DIVISOR)
            if self._about and (count > 1 or fault is not None):
                yield from self._given(count - 1, at_end=True)
        if fault is not None:
            raise fault
        if count < 2:
            raise InputError(
                f"{self._source.title} has {count} frame{'s' * (count != 1)} that can be read: "
                "expected at least 2"
            )

    def _add(self, frame: SourceFrame, number: int) -> None:
        if number == 0:
            camera = SourceCamera.of_first_frame(self._source, self._camera, frame)
            self._source_camera = camera
            for name in (CACHE, PICTURES):
                (self._folder / name).mkdir()
            self._frames = PreparedFrames(
                camera.used, self._folder / CACHE, self._folder / PICTURES
            )
            self._path = SlidingPath(
                self._frames.camera,
                focal_known=self._calibrate == "nothing",
                readout=self._frames.camera.readout,
                limit=camera.focal_limit,
                is_guess=not camera.is_focal_stated,
            )
        self._path.add(*self._frames.add(frame), taken=(frame.index, frame.time))
        self._look_at_time(number, frame)
        self._about[number] = frame.index, frame.name, frame.time

    def _look_at_time(self, number: int, frame: SourceFrame) -> None:
        """Note the first frame whose time is not later than that of the previous frame."""
        if self._have_times_fault or number - 1 not in self._about:
            return
        before = self._about[number - 1]
        fault = time_fault(before[2], frame.time, f"frame {before[1]}", f"frame {frame.name}")
        if fault:
            self._have_times_fault = True
            self._notes.append(f"{fault}: use the numbers of frames instead of times")

    def _given(self, last: int, *, at_end: bool = False) -> Iterator[StreamedFrame]:
        """Yield the frames up to a frame, and drop the data that later frames do not need."""
        path, first = self._path, self._path.settled + 1
        solved = path.found(at_end=at_end)
        self._take_camera()
        if self._path.readout:
            self._frames.unroll_again(solved.rolling)
        pieces = {
            number: self._final(number, piece, solved, first)
            for number, piece in solved.pieces.items()
            if any(first <= frame <= last for frame in piece.poses)
        }
        path.settle(last, pieces)
        placed = {frame: number for number, piece in pieces.items() for frame in piece.poses}
        depths = {
            number: _InOrder(self._depths(number, piece, first - 1))
            for number, piece in pieces.items()
        }
        for frame in range(first, last + 1):
            number = placed.get(frame, -1)
            if number < 0:
                yield self._frame(frame, None, -1, solved.lost[frame], None, False)
                continue
            depth, key = depths[number].of(frame), depths[number].key
            if key is not None and key[0] <= frame:  # a later keyframe may belong to the next call
                self._keys[number] = key
            status = Status("converged") if depth is not None else NO_PARALLAX
            if number not in self._begun and number > 0:
                status = add_piece_note(status)
            self._begun.add(number)
            keyframe = key is not None and key[0] == frame
            yield self._frame(frame, pieces[number].poses[frame], number, status, depth, keyframe)
        self._forget()

    def _take_camera(self) -> None:
        """Use the camera of the path, and warn once if its focal length is unreliable."""
        path = self._path
        self._frames.camera = replace(path.camera, readout=0.0) if path.readout else path.camera
        is_found = path.readout and path.readout_deviation  # a given readout has deviation 0
        camera = self._source_camera
        found = camera.calibration(
            path.focal,
            path.camera,
            sought=self._calibrate != "nothing",
            focal=camera.full.focal / camera.used.focal * path.camera.focal,
            readout=(path.readout or 0.0, path.readout_deviation) if is_found else None,
        )
        if not found.seen and found != self._calibration:
            warnings.warn(found.message, GuessedFocalWarning, stacklevel=5)
        self._calibration = found

    def _final(self, number: int, piece: Piece, solved: SlidingSolution, first: int) -> Piece:
        """Return a piece with its final poses, in the axes of its first frame and its own unit."""
        piece = self._adjusted(number, piece, solved)
        if number in self._begun:
            return piece
        begin = min(frame for frame in piece.poses if frame >= first)
        depth = next(iter(self._depths(number, piece, first - 1)), None)
        if depth is not None:
            unit = median_depth(depth.inverse_depth)
        else:
            seen = self._path.seen[begin]
            unit = float(np.median([*track_depths(seen, piece.points, piece.poses[begin])[1], 1.0]))
        return _moved(piece, piece.poses[begin], unit)

    def _adjusted(self, number: int, piece: Piece, solved: SlidingSolution) -> Piece:
        """Return a piece; new poses are adjusted to the images if the settings ask for accuracy."""
        if self._effort != "accurate":
            return piece
        here = self._remembered(piece)
        if number in self._keys:
            since = self._keys[number][0]
            here = replace(here, poses={f: pose for f, pose in here.poses.items() if f >= since})
        windows = self._depths(number, here, -1).keyframe_windows()
        held = {frame: solved.held[frame] for frame in here.poses if frame in solved.held}
        poses = adjust_poses(
            here.poses, windows, self._frames.grey, self._frames.camera, self._settings, held=held
        )
        return replace(piece, poses={**piece.poses, **poses, **held})

    def _depths(self, number: int, piece: Piece, after: int) -> PieceDepths:
        """Return the depth iterator of the frames of a piece after a frame."""
        depths = PieceDepths(
            self._frames,
            self._remembered(piece),
            self._path.seen,
            self._settings,
            self._effort,
            before=self._keys.get(number),
            after=after,
        )
        # The first keyframe defines the unit: if possible it is a frame that is still to be
        # yielded.
        depths.keyframes = [key for key in depths.keyframes if key > after] or depths.keyframes
        return depths

    def _remembered(self, piece: Piece) -> Piece:
        """Return a piece without its dropped frames."""
        there = set(self._path.seen.frames())
        return replace(
            piece, poses={frame: pose for frame, pose in piece.poses.items() if frame in there}
        )

    def _frame(
        self,
        frame: int,
        pose: np.ndarray | None,
        piece: int,
        status: Status,
        depth: FrameDepth | None,
        keyframe: bool,
    ) -> StreamedFrame:
        index, name, time = self._about.pop(frame)
        shape = self._frames.shape
        return StreamedFrame(
            index=index,
            name=name,
            time=time,
            pose=np.full((4, 4), np.nan) if pose is None else pose.copy(),
            piece=piece,
            status=status,
            keyframe=keyframe,
            # Copies: a keyframe's depth is needed for later frames.
            inverse_depth=np.full(shape, np.nan, np.float32)
            if depth is None
            else depth.inverse_depth.copy(),
            inverse_depth_std=np.full(shape, np.inf, np.float32)
            if depth is None
            else depth.deviation.copy(),
            picture=read_picture(self._folder, frame),
            camera=self._frames.camera,
            calibration=self._calibration,
        )

    def _forget(self) -> None:
        """Drop the data that the path and depth of later frames do not need."""
        self._frames.settle(self._path.settled)
        kept = {key for key, _ in self._keys.values()}
        for frame in self._path.forget(self._path.settled + 1 - MAX_FRAME_DISTANCE, kept=kept):
            self._frames.forget(frame)
        alive = self._path.pieces
        self._keys = {number: key for number, key in self._keys.items() if number in alive}

    def _warn_of_skipped(self) -> None:
        for _, reason in self._source.skipped[self._told :]:
            warnings.warn(f"{reason}; the frame is skipped", stacklevel=4)
        self._told = len(self._source.skipped)


class _InOrder:
    """Depth of frames in order; `PieceDepths` yields keyframes before the frames between them."""

    def __init__(self, depths: PieceDepths) -> None:
        # (int, WindowDepth) or None: the last keyframe that was reached, and its depth
        self.key: tuple[int, WindowDepth] | None = None
        self._depths, self._found = depths, self._sorted(depths)
        self._next: FrameDepth | None = next(self._found, None)

    def of(self, frame: int) -> FrameDepth | None:
        """Return the depth of a frame, or None. Frames have to be requested in order."""
        while self._next is not None and self._next.frame < frame:
            self._next = next(self._found, None)
        return self._next if self._next is not None and self._next.frame == frame else None

    def _sorted(self, depths: PieceDepths) -> Iterator[FrameDepth]:
        waiting: tuple[FrameDepth, WindowDepth] | None = None
        for depth in depths:
            if waiting is not None and depth.frame > waiting[0].frame:
                self.key = waiting[0].frame, waiting[1]
                yield waiting[0]
                waiting = None
            if depth.frame in depths.settled:
                waiting = depth, depths.settled[depth.frame]
            else:
                yield depth
        if waiting is not None:
            self.key = waiting[0].frame, waiting[1]
            yield waiting[0]


def _moved(piece: Piece, origin: np.ndarray, unit: float) -> Piece:
    """Return a piece in the axes of a pose, (4, 4) camera to world, and in another unit."""
    poses = {}
    for frame, pose in piece.poses.items():
        poses[frame] = np.linalg.solve(origin, pose)
        poses[frame][:3, 3] /= unit
    points = {
        track: (point - origin[:3, 3]) @ origin[:3, :3] / unit
        for track, point in piece.points.items()
    }
    return Piece(poses=poses, views=piece.views, points=points)
