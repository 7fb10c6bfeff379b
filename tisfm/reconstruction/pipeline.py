"""One reconstruction, from the source to the folder: reading, the path, depth."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.camera_file import NAME as CAMERA
from tisfm.camera_file import read_camera, write_camera
from tisfm.errors import InputError
from tisfm.focal_guess import FocalGuess, GuessedFocalWarning, guess_focal
from tisfm.outcome import Status
from tisfm.reconstruction.calibration.self_calibration import MAX_EXIF_DEVIATION, make_calibration
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import MAX_USEFUL_DEVIATION, Piece
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.reconstruction.objects.static_path import find_static_path, label_remaining_frames
from tisfm.reconstruction.path.frames_path import FramesPath
from tisfm.reconstruction.path.path_finder import CameraPath
from tisfm.reconstruction.progress import DepthOf, Enough, Progress
from tisfm.reconstruction.result.calibration import (
    GIVEN,
    Calibrate,
    Calibration,
    as_json,
    calibration_in,
)
from tisfm.reconstruction.result.folder import CACHE, PICTURES, write_depth, write_record
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.object_sizes import refuse_unknown
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import track_depths
from tisfm.settings import Settings
from tisfm.shutter import instants_of
from tisfm.sources import FrameSource
from tisfm.sources.frame_reader import warn_notes
from tisfm.trajectory import Trajectory
from tisfm.trajectory.times import times_note
from tisfm.version import __version__

NEW_PIECE = (
    "nothing that it shows leads to the frames before: a new piece begins, in a scale of its own"
)
NO_PARALLAX = Status(
    "little_parallax", "no frame near by shows enough parallax to see depth by; its pose is known"
)


@dataclass(frozen=True, kw_only=True)
class _Read:
    """What is known of the frames once they are read."""

    names: tuple[str, ...]
    times: tuple[float | None, ...]


class Run:
    """One reconstruction, from the source to the folder.

    Parameters
    ----------
    source : FrameSource
    camera : Camera, Path or None
        Of the frames as they come, or its file; None for a guess.
    calibrate : {"nothing", "focal", "radial"}
        What of it is found from the frames.
    settings : Settings
    poses : Trajectory or None
        Those that are given.
    folder : Path
        Ready to be written to.
    progress : callable or None
        As for `tisfm.reconstruct`.
    depth_of : {"all", "keyframes", "none"}
        The frames that depth is found of.
    object_sizes : mapping of int to float, optional
        Lengths of things that move, by their ids.
    labels_stay : bool, default False
        Whether labels that are given are of frames whose lens and readout are undone.
    """

    def __init__(
        self,
        source: FrameSource,
        camera: Camera | Path | None,
        calibrate: Calibrate,
        settings: Settings,
        poses: Trajectory | None,
        folder: Path,
        progress: Progress | None,
        depth_of: DepthOf = "all",
        object_sizes: Mapping[int, float] | None = None,
        *,
        labels_stay: bool = False,
    ) -> None:
        self._source, self._camera, self._settings = source, camera, settings
        self._given, self._folder = poses, folder
        self._calibrate, self._depth_of = calibrate, depth_of
        self._sizes, self._labels_stay = object_sizes or {}, labels_stay
        self._progress: Progress = progress or (lambda stage, done, total: None)
        self._taken: tuple[Camera, tuple[int, int]]  # of the source's frames, and their shape
        self._guess: FocalGuess | None = None
        self._stated = GIVEN
        self._notes = list(source.notes)
        self._frames: PreparedFrames

    def result(self) -> Reconstruction:
        """Read, find the path, then depth; write everything."""
        read, path = self._read()
        calibration = self._calibration(path)
        count = len(read.names)
        poses = np.full((count, 4, 4), np.nan)
        piece = np.full(count, -1, np.int32)
        status: list[Status] = [Status("converged")] * count
        for frame, why in path.lost.items():
            status[frame] = why
        keyframes: list[int] = []
        done = 0
        for number, part in enumerate(path.pieces):
            part = self._adjusted(part, path.seen)
            found, unit = self._depths(part, path.seen, done)
            unseen = self._depth_of == "keyframes" and not found
            done += len(part.poses)
            keyframes += [frame for frame, kind in found.items() if kind == "keyframe"]
            world = np.eye(4) if self._given is not None else part.poses[min(part.poses)]
            for frame, pose in part.poses.items():
                poses[frame], piece[frame] = np.linalg.solve(world, pose), number
                poses[frame, :3, 3] /= unit
                if frame not in found and (self._depth_of == "all" or unseen):
                    status[frame] = NO_PARALLAX
            if number > 0:
                first = min(part.poses)
                status[first] = add_piece_note(status[first])
        about = as_json(calibration)
        del about["shape"]  # the file has width and height
        write_camera(self._folder / CAMERA, *self._taken, about=about)
        result = Reconstruction(
            poses=poses,
            piece=piece,
            unit=(1.0,) * len(path.pieces),
            status=tuple(status),
            keyframes=tuple(sorted(keyframes)),
            camera=self._frames.camera,
            calibration=calibration,
            settings=self._settings,
            names=read.names,
            times=read.times,
            skipped=tuple(self._source.skipped),
            notes=tuple(self._notes),
            shape=self._frames.shape,
            folder=self._folder,
            version=__version__,
            objects=self._objects(poses, piece),
        )
        write_record(self._folder, result)
        return result

    def _read(self) -> tuple[_Read, CameraPath]:
        """Read all frames once, and find the path, or take the one that is given."""
        names: list[str] = []
        times: list[float | None] = []
        indices: list[int] = []
        things = self._settings.motion == "objects"
        found: FramesPath | None = None
        labels: SequenceLabels | None = None
        labelled: list[int] = []  # frames whose labels are given
        total = _count(self._source)
        with closing(self._source.frames()) as frames:
            for frame in frames:
                if not names:
                    height, width = frame.full or frame.image.shape[:2]
                    camera = self._stated_camera((height, width)) or self._guessed(
                        self._source.first_file or frame.full or frame.image.shape
                    )
                    self._taken = camera, (height, width)
                    camera = self._source.camera_after(camera, frame.full)
                    self._frames = PreparedFrames(
                        camera,
                        self._folder / CACHE,
                        self._folder / PICTURES,
                        labels_stay=self._labels_stay,
                    )
                    if not things:
                        found = self._frames_path()
                    elif not self._source.has_labels:
                        labels = SequenceLabels(self._frames.camera)
                grey, ignored = self._frames.add(frame)
                if labels is not None:
                    labels.add(grey)
                elif found is not None:
                    found.add(grey, ignored)
                if frame.labels is not None:
                    labelled.append(len(names))
                names.append(frame.name)
                times.append(frame.time)
                indices.append(frame.index)
                try:
                    self._progress("reading", len(names), total)
                except Enough:
                    break
        if len(names) < 2:
            raise InputError(
                f"{self._source.title} has {len(names)} frame{'s' * (len(names) != 1)} that can "
                "be read: expected at least 2"
            )
        self._progress("path", 0, len(names))
        if note := times_note(times):
            self._notes.append(note)
            warn_notes([note], stacklevel=4)
        instants = instants_of(indices, times)
        if found is not None:
            path = found.finish(times, instants)
            self._take_camera(path)
        else:
            if labels is None:
                self._complete(labelled)

            def path_of(calibrate: Calibrate | None) -> CameraPath:
                anew = self._frames_path(calibrate)
                for number in range(self._frames.count):
                    anew.add(*self._frames.tracked(number), self._frames.flow(number))
                return anew.finish(times, instants)

            path = find_static_path(self._frames, labels, path_of, self._take_camera)
            refuse_unknown(self._sizes, self._frames.things())
        self._progress("path", len(names), len(names))
        return _Read(names=_distinct(names), times=tuple(times)), path

    def _complete(self, labelled: Sequence[int]) -> None:
        """Label the frames whose labels are not given, from those whose are."""
        if not labelled:
            raise InputError(
                f"labels has none of a frame of {self._source.title} that is taken: expected those "
                "of one at least"
            )
        label_remaining_frames(self._frames, labelled)
        refuse_unknown(self._sizes, self._frames.things())  # before what takes long

    def _objects(self, poses: np.ndarray, piece: np.ndarray) -> tuple[MovingObject, ...]:
        """Return the things that move on their own; their depth is written into that of frames."""
        if self._settings.motion != "objects":
            return ()
        from tisfm.reconstruction.objects.object_depth import objects_with_depth

        return objects_with_depth(
            self._frames,
            self._folder,
            poses,
            piece,
            self._settings,
            with_depth=self._depth_of != "none",
            sizes=self._sizes,
        )

    def _frames_path(self, calibrate: Calibrate | None = None) -> FramesPath:
        """Return what finds the path of the frames, or takes the one that is given."""
        stated = self._guess is not None and self._guess.origin == "exif"
        readout = self._frames.camera.readout
        if self._settings.motion == "objects":  # it is undone if it is given, but not looked for
            readout = readout or 0.0
        return FramesPath(
            self._frames.camera,
            self._given,
            calibrate or self._calibrate,
            limit=MAX_EXIF_DEVIATION if stated else MAX_USEFUL_DEVIATION,
            readout=readout,
            focal_known=(
                self._calibrate == "nothing" and self._guess is None and self._stated.seen
            ),
        )

    def _take_camera(self, path: CameraPath) -> None:
        """Take what was found of the camera; frames are made anew where it asks for that."""
        taken, shape = self._taken
        if path.focal is not None:
            taken = taken.with_focal(taken.focal * path.camera.focal / self._frames.camera.focal)
            taken = replace(taken, distortion=path.camera.distortion or taken.distortion)
        self._frames.take(path.camera)
        if path.rolling is not None:
            readout = path.rolling.readout / self._share_of_rows()
            taken = replace(taken, readout=max(-1.0, min(readout, 1.0)))
            self._frames.unroll(path.rolling)
        self._taken = taken, shape

    def _share_of_rows(self) -> float:
        """Return the share of a frame's rows that is left of it, where it is cropped."""
        taken, shape = self._taken
        return self._source.camera_after(replace(taken, readout=1.0), shape).readout or 1.0

    def _stated_camera(self, shape: tuple[int, int]) -> Camera | None:
        """Return the camera that was given, or is in a file, for frames of a shape."""
        if not isinstance(self._camera, Path):
            return self._camera
        camera = read_camera(self._camera, shape)
        self._stated = calibration_in(self._camera, camera.focal)
        return camera

    def _guessed(self, first: Path | tuple[int, ...]) -> Camera:
        """Return a camera with a focal length guessed by the first frame, or its shape."""
        self._guess = guess_focal(first)
        return Camera(focal=self._guess.focal)

    def _calibration(self, path: CameraPath) -> Calibration:
        """Return where the focal length is from; warn if it is not to be relied on."""
        found = make_calibration(
            path.focal,
            self._guess,
            self._frames.camera,
            sought=self._calibrate != "nothing",
            focal=self._taken[0].focal,
            shape=self._taken[1],
            stated=self._stated,
        )
        if path.rolling is not None and path.rolling.deviation:  # it was not given
            deviation = path.rolling.deviation / self._share_of_rows()
            readout = self._taken[0].readout or 0.0
            found = replace(found, readout=readout, readout_std=deviation)
        if not found.seen:
            warnings.warn(found.message, GuessedFocalWarning, stacklevel=4)
        return found

    def _adjusted(self, piece: Piece, seen: Sequence[Observations]) -> Piece:
        """Return the piece with poses adjusted to the images, if there are any to adjust."""
        from tisfm.reconstruction.depth.pose_adjustment import adjust_poses
        from tisfm.reconstruction.depth.segment_depth import PieceDepths, depth_effort

        effort = depth_effort(self._settings)
        if self._given is not None or effort != "accurate":
            return piece
        stars = PieceDepths(self._frames, piece, seen, self._settings, effort="fast").stars()
        frames, camera = self._frames.grey, self._frames.camera
        poses = adjust_poses(piece.poses, stars, frames, camera, self._settings)
        return replace(piece, poses=poses)

    def _depths(
        self, piece: Piece, seen: Sequence[Observations], done: int
    ) -> tuple[dict[int, str], float]:
        """Write the depth of a piece's frames; return what each is, and the unit of its depth."""
        if self._depth_of == "none":
            return {}, median_track_depth(piece, seen)
        from tisfm.reconstruction.depth.segment_depth import PieceDepths, depth_effort, median_depth

        depths = PieceDepths(
            self._frames,
            piece,
            seen,
            self._settings,
            effort=depth_effort(self._settings),
            after=max(piece.poses) if self._depth_of == "keyframes" else -1,
        )
        found: dict[int, str] = {}
        unit = 1.0
        for depth in depths:
            if not found and self._given is None:
                unit = median_depth(depth.inverse_depth)
            write_depth(
                self._folder, depth.frame, depth.inverse_depth * unit, depth.deviation * unit
            )
            found[depth.frame] = "keyframe" if depth.frame in depths.keyframes else "between"
            self._progress("depth", done + len(found), len(seen))
        if not found and self._given is None:
            unit = median_track_depth(piece, seen)
        return found, unit


def median_track_depth(piece: Piece, seen: Sequence[Observations]) -> float:
    """Return the median depth of tracks in the first frame of a piece that shows any; 1 if none."""
    for frame, pose in piece.poses.items():
        _, depths = track_depths(seen[frame], piece.points, pose)
        if len(depths):
            return float(np.median(depths))
    return 1.0


def add_piece_note(status: Status) -> Status:
    """Return the status of a frame that begins another piece than the first."""
    message = f"{status.message}; {NEW_PIECE}" if status.message else NEW_PIECE
    return Status(str(status), message)


def remove_piece_note(status: Status) -> Status:
    """Return what the status of a frame was before `add_piece_note` said that a piece begins."""
    return Status(str(status), status.message.removesuffix(NEW_PIECE).removesuffix("; "))


def _count(source: FrameSource) -> int | None:
    try:
        return len(source) + 1
    except TypeError:
        return None


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names, numbered if two are alike."""
    listed = list(names)
    if len(set(listed)) == len(listed):
        return tuple(listed)
    return tuple(f"{k:06d}_{name}" for k, name in enumerate(listed))
