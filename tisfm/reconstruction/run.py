"""One reconstruction, from the source to the folder: reading, the path, depth."""

import warnings
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.camera_file import NAME as CAMERA
from tisfm.camera_file import read_camera, write_camera
from tisfm.focal_guess import FocalGuess, GuessedFocalWarning, guess_focal
from tisfm.outcome import Status
from tisfm.reconstruction.calibration import GIVEN, Calibrate, Calibration, as_json, calibration_in
from tisfm.reconstruction.folder import (
    CACHE,
    PICTURES,
    depth_path,
    read_depth,
    read_labels,
    write_depth,
    write_labels,
    write_record,
)
from tisfm.reconstruction.frames import PreparedFrames
from tisfm.reconstruction.given_poses import poses_of_frames
from tisfm.reconstruction.moving_object import MovingObject, seen_objects
from tisfm.reconstruction.path import TRACKING, CameraPath, PathFinder
from tisfm.reconstruction.progress import DepthOf, Enough, Progress
from tisfm.reconstruction.result import Reconstruction
from tisfm.reconstruction.self_calibration import OF_EXIF, WORTHLESS, calibration_of
from tisfm.reconstruction.sequence_labels import SequenceLabels
from tisfm.reconstruction.shelf import Shelf
from tisfm.reconstruction.sparse_points import depths_of, triangulated
from tisfm.reconstruction.tracks import Seen, Tracker
from tisfm.reconstruction.unrolling import Unrolling
from tisfm.reconstruction.way import Piece
from tisfm.settings import Settings
from tisfm.shutter import instants_of
from tisfm.sources import FrameSource
from tisfm.trajectory import Trajectory
from tisfm.version import __version__

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
    ) -> None:
        self._source, self._camera, self._settings = source, camera, settings
        self._given, self._folder = poses, folder
        self._calibrate, self._depth_of = calibrate, depth_of
        self._progress: Progress = progress or (lambda stage, done, total: None)
        self._taken: tuple[Camera, tuple[int, int]]  # of the source's frames, and their shape
        self._guess: FocalGuess | None = None
        self._stated = GIVEN
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
                status[first] = begins_piece(status[first])
        write_camera(self._folder / CAMERA, *self._taken, about=as_json(calibration))
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
        finder: PathFinder | None = None
        tracker: Tracker | None = None
        labels: SequenceLabels | None = None
        seen = Shelf(Seen.arrays, Seen.of_arrays)
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
                        camera, self._folder / CACHE, self._folder / PICTURES
                    )
                    finder = self._finder()
                    tracker = Tracker(self._frames.camera, TRACKING)
                    if self._settings.motion == "objects":
                        labels = SequenceLabels(self._frames.camera)
                grey, ignored = self._frames.add(frame)
                if labels is not None:
                    labels.add(grey)
                elif self._given is None and finder is not None:
                    finder.add(grey, ignored)
                elif tracker is not None:
                    seen.append(tracker.go_on(grey, ignored))
                names.append(frame.name)
                times.append(frame.time)
                indices.append(frame.index)
                try:
                    self._progress("reading", len(names), total)
                except Enough:
                    break
        if len(names) < 2 or finder is None:
            raise ValueError(
                f"{self._source.title} has {len(names)} frame{'s' * (len(names) != 1)} that can "
                "be read: expected at least 2"
            )
        self._progress("path", 0, len(names))
        instants = instants_of(indices, times)
        if labels is not None:
            path = self._path_among_things(labels, len(names), times, instants)
        elif self._given is None:
            path = finder.finish(instants)
        else:
            path = self._given_path(seen, self._given, times, instants)
        self._take_camera(path)
        self._progress("path", len(names), len(names))
        return _Read(names=_distinct(names), times=tuple(times)), path

    def _finder(self) -> PathFinder:
        """Return what finds the path of the frames."""
        stated = self._guess is not None and self._guess.origin == "exif"
        together = self._settings.motion == "objects"  # rows count as read at once
        return PathFinder(
            self._frames.camera,
            self._calibrate,
            limit=OF_EXIF if stated else WORTHLESS,
            readout=0.0 if together else self._frames.camera.readout,
        )

    def _path_among_things(
        self,
        labels: SequenceLabels,
        count: int,
        times: Sequence[float | None],
        instants: np.ndarray,
    ) -> CameraPath:
        """Label what moves on its own, and return the path that is left; write the labels.

        The first labels need no path. Under that which they leave, many frames say more.
        """
        self._label(labels.found())
        path = self._path_of_what_counts(count, times, instants)
        poses: list[np.ndarray | None] = [None] * count
        if path.pieces:
            largest = max(path.pieces, key=lambda piece: len(piece.poses))
            for frame, pose in largest.poses.items():
                poses[frame] = pose
        if self._label(labels.found(poses, path.camera.pinhole())):
            path = self._path_of_what_counts(count, times, instants)
        return path

    def _path_of_what_counts(
        self, count: int, times: Sequence[float | None], instants: np.ndarray
    ) -> CameraPath:
        """Return the path that frames show which have been read."""
        if self._given is None:
            finder = self._finder()
            for number in range(count):
                finder.add(*self._frames.tracked(number))
            return finder.finish(instants)
        tracker = Tracker(self._frames.camera, TRACKING)
        seen = Shelf(Seen.arrays, Seen.of_arrays)
        for number in range(count):
            seen.append(tracker.go_on(*self._frames.tracked(number)))
        return self._given_path(seen, self._given, times, instants)

    def _label(self, labels: Iterable[np.ndarray]) -> bool:
        """Write the labels of every frame, and return whether they are others than before.

        What moves on its own counts no more.
        """
        changed = False
        for number, labelled in enumerate(labels):
            ignored = self._frames.ignored(number)
            if ignored is not None:
                labelled[ignored] = 0
            before = self._frames.aside(number)
            changed |= not np.array_equal(before, labelled > 0)
            write_labels(self._folder, number, labelled)
            self._frames.set_aside(number, labelled > 0)
        return changed

    def _objects(self, poses: np.ndarray, piece: np.ndarray) -> tuple[MovingObject, ...]:
        """Return the things that move on their own; their depth is written into that of frames."""
        if self._settings.motion != "objects":
            return ()
        from tisfm.reconstruction.own_path import own_path, placed

        folder, shape = self._folder, self._frames.shape

        def labelled(frame: int) -> np.ndarray:
            return read_labels(folder, frame, shape)

        def at_rest(frame: int) -> np.ndarray:
            return read_depth(folder, frame, shape)[0]

        known = piece[piece >= 0]
        largest = int(np.bincount(known).argmax()) if len(known) else 0
        world = np.where((piece == largest)[:, None, None], poses, np.nan)
        found = []
        for thing in seen_objects(len(poses), labelled):
            own = own_path(
                thing,
                self._frames,
                labelled,
                self._settings,
                with_depth=self._depth_of != "none",
            )
            if isinstance(own, str):
                found.append(replace(thing, message=own))
                continue
            thing, scale = placed(thing, own, world, at_rest, labelled)
            found.append(thing)
            for depth in own.depths:
                frame = own.frames[depth.frame]
                if piece[frame] != largest or not depth_path(folder, frame).exists():
                    continue
                mine = (labelled(frame) == thing.id) & np.isfinite(depth.inverse_depth)
                inverse_depth, deviation = read_depth(folder, frame, shape)
                inverse_depth[mine] = depth.inverse_depth[mine] / scale
                deviation[mine] = depth.deviation[mine] / scale
                write_depth(folder, frame, inverse_depth, deviation)
        return tuple(found)

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

    def _given_path(
        self,
        seen: Sequence[Seen],
        given: Trajectory,
        times: Sequence[float | None],
        instants: np.ndarray,
    ) -> CameraPath:
        camera, shape = self._frames.camera, self._frames.shape
        poses, lost = poses_of_frames(given, times)
        known = {k: pose for k, pose in enumerate(poses) if k not in lost}
        points = triangulated(seen, known, camera, shape)
        piece, rolling = Piece(poses=known, views=tuple(known), points=points), None
        if known and camera.readout:  # poses are those of middle rows
            unrolling = Unrolling(seen, [piece], instants, camera.readout, 0.0, camera, shape)
            seen, rolling = unrolling.all_tracks(), unrolling.rolling
            piece = replace(piece, points=triangulated(seen, known, camera, shape))
        return CameraPath(
            pieces=(piece,) if known else (),
            lost=lost,
            seen=seen,
            camera=camera,
            rolling=rolling,
        )

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
        found = calibration_of(
            path.focal,
            self._guess,
            self._frames.camera,
            sought=self._calibrate != "nothing",
            stated=self._stated,
        )
        if path.rolling is not None and path.rolling.deviation:  # it was not given
            deviation = path.rolling.deviation / self._share_of_rows()
            readout = self._taken[0].readout or 0.0
            found = replace(found, readout=readout, readout_std=deviation)
        if not found.seen:
            warnings.warn(found.message, GuessedFocalWarning, stacklevel=4)
        return found

    def _adjusted(self, piece: Piece, seen: Sequence[Seen]) -> Piece:
        """Return the piece with poses adjusted to the images, if there are any to adjust."""
        from tisfm.reconstruction.adjustment import adjusted
        from tisfm.reconstruction.depths import PieceDepths, effort_of

        effort = effort_of(self._settings)
        if self._given is not None or effort != "accurate":
            return piece
        stars = PieceDepths(self._frames, piece, seen, self._settings, effort="fast").stars()
        frames, camera = self._frames.grey, self._frames.camera
        poses = adjusted(piece.poses, stars, frames, camera, self._settings)
        return replace(piece, poses=poses)

    def _depths(
        self, piece: Piece, seen: Sequence[Seen], done: int
    ) -> tuple[dict[int, str], float]:
        """Write the depth of a piece's frames; return what each is, and the unit of its depth."""
        if self._depth_of == "none":
            return {}, unit_of_points(piece, seen)
        from tisfm.reconstruction.depths import PieceDepths, effort_of, unit_of

        depths = PieceDepths(
            self._frames,
            piece,
            seen,
            self._settings,
            effort=effort_of(self._settings),
            after=max(piece.poses) if self._depth_of == "keyframes" else -1,
        )
        found: dict[int, str] = {}
        unit = 1.0
        for depth in depths:
            if not found and self._given is None:
                unit = unit_of(depth.inverse_depth)
            write_depth(
                self._folder, depth.frame, depth.inverse_depth * unit, depth.deviation * unit
            )
            found[depth.frame] = "keyframe" if depth.frame in depths.keyframes else "between"
            self._progress("depth", done + len(found), len(seen))
        if not found and self._given is None:
            unit = unit_of_points(piece, seen)
        return found, unit


def unit_of_points(piece: Piece, seen: Sequence[Seen]) -> float:
    """Return the median depth of tracks in the first frame of a piece that shows any; 1 if none."""
    for frame, pose in piece.poses.items():
        _, depths = depths_of(seen[frame], piece.points, pose)
        if len(depths):
            return float(np.median(depths))
    return 1.0


def begins_piece(status: Status) -> Status:
    """Return the status of a frame that begins another piece than the first."""
    told = "nothing that it shows leads to the frames before: a new piece begins, in a scale of "
    told += "its own"
    return Status(str(status), f"{status.message}; {told}" if status.message else told)


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
