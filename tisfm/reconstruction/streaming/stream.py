"""The pipeline of an endless sequence: read → track → solve → depth → yield, for recent frames.

The stages are those of a whole sequence (`tisfm.reconstruction.pipeline`): the same tracker, path
solver and depth. They run again and again for the recent frames. Results of yielded frames stay
fixed, and data that later frames do not need are dropped.
"""

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.grade import depth_error
from tisfm.reconstruction.calibration.source_camera import SourceCamera
from tisfm.reconstruction.depth.pose_adjustment import adjust_poses
from tisfm.reconstruction.depth.segment_depth import (
    FrameDepth,
    PieceDepths,
    depth_effort,
    median_depth,
)
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.window_depth import WindowDepth
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.result.calibration import GIVEN, Calibrate
from tisfm.reconstruction.result.folder import CACHE, PICTURES, read_picture
from tisfm.reconstruction.result.statuses import NO_PARALLAX, add_piece_note, mark_uncertain
from tisfm.reconstruction.streaming.ordered_depth import OrderedDepth
from tisfm.reconstruction.streaming.sliding_path import SlidingPath, SlidingSolution
from tisfm.reconstruction.streaming.stream_checks import StreamChecks
from tisfm.reconstruction.streaming.streamed_frame import StreamedFrame
from tisfm.reconstruction.tracks.triangulation import track_depths
from tisfm.settings import Settings
from tisfm.sources import FrameSource, SourceFrame
from tisfm.sources.frame_reader import warn_notes
from tisfm.status import Status
from tisfm.trajectory.times import time_fault

# The last frames help to find the path, but are yielded in a later call. Their number is the delay
# divided by this number, which was set by hand.
LOOKAHEAD_DIVISOR = 3


class Stream:
    """Reconstructs an endless sequence: yields each frame with its pose and depth."""

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
        # by frame that is not yielded yet: number in the source, name and time, s
        self._frame_info: dict[int, tuple[int, str, float | None]] = {}
        self._last_keyframes: dict[int, tuple[int, WindowDepth]] = {}  # last keyframe of each piece
        self._yielded_pieces: set[int] = set()  # pieces with yielded frames
        self._checks: StreamChecks
        self._warned_count = 0
        self._notes: list[str] = list(source.notes)  # notes that were not shown as warnings yet
        self._has_times_fault = False

    def frames(self) -> Iterator[StreamedFrame]:
        """Yield every frame in order; an error of the source follows the frames before it."""
        source_error: Exception | None = None
        count = 0
        with (
            TemporaryDirectory(prefix="tisfm-") as folder,
            closing(self._source.frames()) as source_frames,
        ):
            self._folder = Path(folder)
            while source_error is None:
                try:
                    frame = next(source_frames, None)
                    if frame is None:
                        break
                    self._add(frame, count)
                except Exception as error:
                    source_error = error
                    break
                finally:
                    self._warn_about_skipped()
                    warn_notes(self._notes, stacklevel=4)
                    self._notes.clear()
                del frame  # so that its memory is free while frames are yielded
                count += 1
                if len(self._frame_info) > self._delay:
                    yield from self._yield_frames(count - 1 - self._delay // LOOKAHEAD_DIVISOR)
            if self._frame_info and (count > 1 or source_error is not None):
                yield from self._yield_frames(count - 1, at_end=True)
        if source_error is not None:
            raise source_error
        if count < 2:
            raise InputError(
                f"{self._source.title} has {count} frame{'s' * (count != 1)} that can be read: "
                "expected at least 2"
            )

    def _add(self, frame: SourceFrame, number: int) -> None:
        if number == 0:
            camera = SourceCamera.from_first_frame(self._source, self._camera, frame)
            self._source_camera = camera
            for name in (CACHE, PICTURES):
                (self._folder / name).mkdir()
            self._frames = PreparedFrames(
                camera.used_camera, self._folder / CACHE, self._folder / PICTURES
            )
            self._path = SlidingPath(
                self._frames.camera,
                is_focal_fixed=self._calibrate == "nothing",
                readout=self._frames.camera.readout,
                max_deviation=camera.max_focal_deviation,
                is_focal_guessed=not camera.is_focal_known,
                grey=lambda frame: self._frames.tracker_input(frame)[0],
            )
            self._checks = StreamChecks(self._path, self._frames)
        self._path.add(*self._frames.add(frame), index_and_time=(frame.index, frame.time))
        self._check_time(number, frame)
        self._frame_info[number] = frame.index, frame.name, frame.time

    def _check_time(self, number: int, frame: SourceFrame) -> None:
        """Note the first frame whose time is not later than that of the previous frame."""
        if self._has_times_fault or number - 1 not in self._frame_info:
            return
        previous = self._frame_info[number - 1]
        fault = time_fault(previous[2], frame.time, f"frame {previous[1]}", f"frame {frame.name}")
        if fault:
            self._has_times_fault = True
            self._notes.append(f"{fault}: use the numbers of frames instead of times")

    def _yield_frames(self, last: int, *, at_end: bool = False) -> Iterator[StreamedFrame]:
        """Yield the frames up to a frame; drop the data that later frames do not need."""
        first = self._path.last_fixed + 1
        solution = self._path.solve(at_end=at_end)
        self._update_camera()
        if self._path.readout:
            self._frames.correct_provisionally(solution.rolling)
        pieces = {
            number: self._final_piece(number, piece, solution, first)
            for number, piece in solution.pieces.items()
            if any(first <= frame <= last for frame in piece.poses)
        }
        self._path.fix_poses(last, pieces)
        contradictions = self._checks.find_contradictions(pieces, first, last)
        yield from self._find_depth(pieces, contradictions, solution.missing, first, last)
        self._drop_unneeded()

    def _find_depth(
        self,
        pieces: Mapping[int, Piece],
        contradictions: Mapping[int, Status],  # by contradicted piece
        missing: Mapping[int, Status],
        first: int,
        last: int,
    ) -> Iterator[StreamedFrame]:
        """Find the depth of the frames from `first` to `last`, and yield the frames."""
        numbers = {frame: number for number, piece in pieces.items() for frame in piece.poses}
        depths = {
            number: OrderedDepth(self._depths(number, piece, first - 1))
            for number, piece in pieces.items()
        }
        for frame in range(first, last + 1):
            number = numbers.get(frame, -1)
            if number < 0:
                yield self._make_frame(frame, None, -1, missing[frame], None, False)
                continue
            depth, last_keyframe = depths[number].depth_of(frame), depths[number].last_keyframe
            if (
                last_keyframe is not None and last_keyframe[0] <= frame
            ):  # a later keyframe may belong to the next call
                self._last_keyframes[number] = last_keyframe
            status = Status("converged") if depth is not None else NO_PARALLAX
            status = contradictions.get(number, status)
            if number not in self._yielded_pieces and number > 0:
                status = add_piece_note(status)
            self._yielded_pieces.add(number)
            keyframe = last_keyframe is not None and last_keyframe[0] == frame
            yield self._make_frame(
                frame, pieces[number].poses[frame], number, status, depth, keyframe
            )

    def _update_camera(self) -> None:
        """Use the camera of the path, and warn once if its focal length is unreliable."""
        path = self._path
        self._frames.camera = replace(path.camera, readout=0.0) if path.readout else path.camera
        # A given readout has deviation 0.
        is_readout_estimated = path.readout and path.readout_deviation
        camera = self._source_camera
        calibration = camera.calibration(
            path.focal,
            path.camera,
            is_estimated=self._calibrate != "nothing",
            focal=camera.full_camera.focal / camera.used_camera.focal * path.camera.focal,
            readout=(path.readout or 0.0, path.readout_deviation) if is_readout_estimated else None,
        )
        if not calibration.seen and calibration != self._calibration:
            warnings.warn(calibration.message, GuessedFocalWarning, stacklevel=5)
        self._calibration = calibration

    def _final_piece(
        self, number: int, piece: Piece, solution: SlidingSolution, first: int
    ) -> Piece:
        """Return a piece with its final poses, in the axes of its first frame and its own unit."""
        piece = self._adjust_poses(number, piece, solution)
        if number in self._yielded_pieces:
            return piece
        begin = min(frame for frame in piece.poses if frame >= first)
        depth = next(iter(self._depths(number, piece, first - 1)), None)
        if depth is not None:
            unit = median_depth(depth.inverse_depth)
        else:
            observations = self._path.observations[begin]
            unit = float(
                np.median([*track_depths(observations, piece.points, piece.poses[begin])[1], 1.0])
            )
        return _transform_piece(piece, piece.poses[begin], unit)

    def _adjust_poses(self, number: int, piece: Piece, solution: SlidingSolution) -> Piece:
        """Return the piece; new poses are adjusted to images if the settings ask for accuracy."""
        if self._effort != "accurate":
            return piece
        recent = self._path.select_recent(piece)
        if number in self._last_keyframes:
            first = self._last_keyframes[number][0]
            poses = {frame: pose for frame, pose in recent.poses.items() if frame >= first}
            recent = replace(recent, poses=poses)
        windows = self._depths(number, recent, -1).keyframe_windows()
        fixed_poses = {
            frame: solution.fixed_poses[frame]
            for frame in recent.poses
            if frame in solution.fixed_poses
        }
        grey, camera = self._frames.grey, self._frames.camera
        poses = adjust_poses(
            recent.poses, windows, grey, camera, self._settings, fixed_frames=fixed_poses
        )
        return replace(piece, poses={**piece.poses, **poses, **fixed_poses})

    def _depths(self, number: int, piece: Piece, after: int) -> PieceDepths:
        """Return the iterator over the depth of the frames of a piece later than frame `after`."""
        depths = PieceDepths(
            self._frames,
            self._path.select_recent(piece),
            self._path.observations,
            self._settings,
            self._effort,
            start_keyframe=self._last_keyframes.get(number),
            written_until=after,
        )
        # The first keyframe defines the unit. If possible, this keyframe was not yielded yet.
        depths.keyframes = [key for key in depths.keyframes if key > after] or depths.keyframes
        return depths

    def _make_frame(
        self,
        frame: int,
        pose: np.ndarray | None,
        piece: int,
        status: Status,
        depth: FrameDepth | None,
        keyframe: bool,
    ) -> StreamedFrame:
        index, name, time = self._frame_info.pop(frame)
        shape = self._frames.shape
        error, share = math.nan, 0.0
        if depth is not None:
            focal_deviation = self._calibration.relative_focal_std
            error, share = depth_error(
                depth.inverse_depth,
                depth.deviation,
                focal_deviation,
                residual_factor=self._checks.residual_factor(piece),
            )
            (status,) = mark_uncertain([status], np.array([error]))
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
            depth_error=error,
            depth_share=share,
        )

    def _drop_unneeded(self) -> None:
        """Drop the data that the path and the depth of later frames do not need."""
        self._frames.finalise_corrections(self._path.last_fixed)
        keyframes = {key for key, _ in self._last_keyframes.values()}
        first = self._path.last_fixed + 1 - DEPTH.max_frame_distance
        for frame in self._path.drop_before(first, keyframes=keyframes):
            self._frames.delete(frame)
        self._last_keyframes = {
            number: keyframe
            for number, keyframe in self._last_keyframes.items()
            if number in self._path.pieces
        }

    def _warn_about_skipped(self) -> None:
        for _, reason in self._source.skipped[self._warned_count :]:
            warnings.warn(f"{reason}; the frame is skipped", stacklevel=4)
        self._warned_count = len(self._source.skipped)


def _transform_piece(piece: Piece, origin: np.ndarray, unit: float) -> Piece:
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
