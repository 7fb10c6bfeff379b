"""The pipeline of a whole sequence: read → track → solve → depth → check → write.

Each stage is a function. It takes the frozen results of earlier stages, and returns its own result:
`read_frames` (which tracks each frame while the next one is read), `solve_path`, `find_depth`,
`check_pieces` and `write_result`. Prepared frames and depth are too large for memory: they are
stored in the folder of the result.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.camera_file import FILE_NAME as CAMERA
from tisfm.camera_file import write_camera
from tisfm.errors import InputError
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.grade import depth_error
from tisfm.reconstruction.calibration.source_camera import SourceCamera
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.objects.sequence_labels import (
    SequenceLabels,
    find_static_path,
    label_remaining_frames,
)
from tisfm.reconstruction.path.camera_revision import revise_path
from tisfm.reconstruction.path.given_path import given_path
from tisfm.reconstruction.path.path_solver import CameraPath, PathSolver
from tisfm.reconstruction.path_checks.fixed_texture import camera_turns, find_fixed_pixels
from tisfm.reconstruction.path_checks.pieces import check_piece
from tisfm.reconstruction.progress import DepthOf, FixedPixels, Progress, ReportDepth, StopReading
from tisfm.reconstruction.result.calibration import Calibrate, Calibration, as_json
from tisfm.reconstruction.result.folder import (
    CACHE,
    PICTURES,
    depth_path,
    read_depth,
    write_depth,
    write_mask,
    write_record,
)
from tisfm.reconstruction.result.moving_object import MovingObject, refuse_unknown_ids
from tisfm.reconstruction.result.path_check import UNCHECKED, PathCheck
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.statuses import (
    NO_PARALLAX,
    ONLY_TURNS,
    add_piece_note,
    mark_contradicted,
    mark_uncertain,
)
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracker, SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import track_depths
from tisfm.settings import Settings
from tisfm.shutter import frame_instants
from tisfm.sources import FrameSource
from tisfm.sources.frame_reader import warn_notes
from tisfm.status import Status
from tisfm.trajectory import Trajectory
from tisfm.trajectory.times import times_note
from tisfm.version import __version__


def _no_progress(stage: str, done: int, total: int | None) -> None:
    """Ignore the progress."""


def _no_report(frame: int, error: float) -> None:
    """Ignore the expected error of the depth of a frame."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """A sequence to reconstruct, with the checked arguments of `tisfm.reconstruct`."""

    source: FrameSource
    # camera of the frames of the source, or its file; None for a guess
    camera: Camera | Path | None
    calibrate: Calibrate  # the part of the camera that is estimated from the frames
    settings: Settings
    poses: Trajectory | None  # given poses
    folder: Path  # folder of the result, ready to be written to
    progress: Progress = _no_progress  # as for `tisfm.reconstruct`
    report_depth: ReportDepth = _no_report  # as for `tisfm.reconstruct`
    fixed_pixels: FixedPixels = "mask"  # whether pixels that are fixed on the sensor are masked
    depth_of: DepthOf = "all"  # the frames whose depth is estimated
    # known lengths of moving objects, by their ids
    object_sizes: Mapping[int, float] = field(default_factory=dict)
    # whether a zoom is searched that the camera does not state
    revises_camera: bool = False
    # whether given labels already belong to frames without distortion and readout effect
    are_labels_prepared: bool = False

    @property
    def masks_fixed_pixels(self) -> bool:
        """Whether pixels that are fixed on the sensor are searched and masked."""
        return self.fixed_pixels == "mask"

    @property
    def has_objects(self) -> bool:
        """Whether moving objects are labelled and reconstructed."""
        return self.settings.motion == "objects"


@dataclass(frozen=True, kw_only=True)
class ReadingResult:
    """The frames of a sequence after the reading stage."""

    names: tuple[str, ...]
    times: tuple[float | None, ...]  # times of the frames, s
    # (N,) array: times of the frames, in intervals between frames of the source
    instants: np.ndarray
    camera: SourceCamera
    # later stages correct these frames for the estimated lens and readout, and label them
    frames: PreparedFrames
    # None with moving objects: static points are tracked later, when labels are known
    tracks: SequenceTracks | None
    # the search for moving objects; None without moving objects, or with given labels
    labels: SequenceLabels | None
    labelled_frames: tuple[int, ...]  # frames with given labels
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class PathResult:
    """The camera path, and the camera that was estimated with the path."""

    path: CameraPath
    camera: Camera  # camera of the frames of the source, before crop and reduction
    # (H, W) bool, or None: pixels that are fixed on the sensor, and masked in all frames
    fixed_pixels: np.ndarray | None = None
    # (N,) float64: focal length of each frame over that of `camera`; None if it is constant
    zoom: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class DepthResult:
    """Poses in the unit of depth, after the depth of all frames was written."""

    poses: np.ndarray  # (N, 4, 4) float64: camera to world; NaN for a frame without a pose
    piece: np.ndarray  # (N,) int32: the piece of each frame, −1 for none
    status: tuple[Status, ...]
    keyframes: tuple[int, ...]
    # (N,) float64: expected relative error of the depth of each frame, NaN without depth, and the
    # share of good pixels, as `tisfm.grade.depth_error` returns them
    error: np.ndarray
    share: np.ndarray


def reconstruct_sequence(job: Job) -> Reconstruction:
    """Run all stages."""
    reading = read_frames(job)
    path_result = solve_path(job, reading)
    calibration = _calibration(job, reading, path_result)
    depth = find_depth(job, reading, path_result.path, calibration.relative_focal_std)
    checks = check_pieces(job, reading.frames, path_result.path, depth)
    return write_result(job, reading, path_result, calibration, depth, checks)


def read_frames(job: Job) -> ReadingResult:
    """Read and prepare all frames once; track each frame while the next frame is read."""
    names: list[str] = []
    times: list[float | None] = []
    indices: list[int] = []
    labelled_frames: list[int] = []
    tracker: SequenceTracker | None = None
    labels: SequenceLabels | None = None
    source, total = job.source, _frame_count(job.source)
    with closing(source.frames()) as source_frames:
        for frame in source_frames:
            if not names:
                camera = SourceCamera.from_first_frame(source, job.camera, frame)
                frames = PreparedFrames(
                    camera.used_camera,
                    job.folder / CACHE,
                    job.folder / PICTURES,
                    are_labels_prepared=job.are_labels_prepared,
                )
                if not job.has_objects:
                    tracker = _make_tracker(job, frames.camera, job.calibrate)
                elif not source.has_labels:
                    labels = SequenceLabels(frames.camera)
            grey, ignored = frames.add(frame)
            if labels is not None:
                labels.add(grey)
            elif tracker is not None:
                tracker.add(grey, ignored)
            if frame.labels is not None:
                labelled_frames.append(len(names))
            names.append(frame.name)
            times.append(frame.time)
            indices.append(frame.index)
            try:
                job.progress("reading", len(names), total)
            except StopReading:
                break
    if len(names) < 2:
        raise InputError(
            f"{source.title} has {len(names)} frame{'s' * (len(names) != 1)} that can "
            "be read: expected at least 2"
        )
    job.progress("path", 0, len(names))
    notes = list(source.notes)
    if note := times_note(times):
        notes.append(note)
        warn_notes([note], stacklevel=4)
    return ReadingResult(
        names=_distinct_names(names),
        times=tuple(times),
        instants=frame_instants(indices, times),
        camera=camera,
        frames=frames,
        tracks=None if tracker is None else tracker.finish(),
        labels=labels,
        labelled_frames=tuple(labelled_frames),
        notes=tuple(notes),
    )


def solve_path(job: Job, reading: ReadingResult) -> PathResult:
    """Find the camera path, or use given poses; correct frames for the estimated lens and readout.

    With moving objects, every frame is labelled as well.
    """
    frames, full_camera = reading.frames, reading.camera.full_camera
    mask: np.ndarray | None = None

    def correct(path: CameraPath) -> None:
        nonlocal full_camera, mask
        if path.focal is not None:
            full_camera = full_camera.with_focal(
                full_camera.focal * path.camera.focal / frames.camera.focal
            )
            full_camera = replace(
                full_camera, distortion=path.camera.distortion or full_camera.distortion
            )
        if path.rolling is not None:
            full_camera = replace(
                full_camera, readout=reading.camera.full_readout(path.rolling.readout)
            )
        mask = frames.correct(path.camera, path.rolling, path.zoom, mask)

    def solve_static_path(calibrate: Calibrate | None) -> CameraPath:
        return _track_and_solve(job, reading, calibrate or job.calibrate)

    if reading.tracks is not None:
        if masked := _mask_fixed_pixels(job, reading):
            path, mask = masked
        else:
            path = _solve_or_take_path(job, reading, reading.tracks, job.calibrate)
        correct(path)
    else:
        labels = reading.labels
        if masked := _mask_fixed_pixels(job, reading):
            mask = masked[1]
            if labels is not None:
                labels = SequenceLabels.of_frames(frames)
        if labels is None:
            _label_all_frames(job, reading)
        path = find_static_path(frames, labels, solve_static_path, correct)
        refuse_unknown_ids(job.object_sizes, frames.object_ids())
    job.progress("path", len(reading.names), len(reading.names))
    return PathResult(path=path, camera=full_camera, fixed_pixels=mask, zoom=path.zoom)


def _track_and_solve(
    job: Job, reading: ReadingResult, calibrate: Calibrate, mask: np.ndarray | None = None
) -> CameraPath:
    """Return the path from new tracks; pixels of a mask, (H, W) bool, have no tracks."""
    frames = reading.frames
    tracker = _make_tracker(job, frames.camera, calibrate)
    for number in range(frames.count):
        grey, ignored = frames.tracker_input(number)
        if mask is not None:
            ignored = mask if ignored is None else ignored | mask
        tracker.add(grey, ignored, frames.flow(number))
    return _solve_or_take_path(job, reading, tracker.finish(), calibrate)


def _mask_fixed_pixels(job: Job, reading: ReadingResult) -> tuple[CameraPath, np.ndarray] | None:
    """Mask pixels that are fixed on the sensor; return the path without them, and the mask.

    The mask is (H, W) bool. The result is None if there are hardly any such pixels, or if the path
    without them shows no turn: then they may be far points.
    """
    frames = reading.frames
    mask = find_fixed_pixels(frames) if job.masks_fixed_pixels else None
    if mask is None:
        return None
    path = _track_and_solve(job, reading, job.calibrate, mask)
    if not camera_turns(path.pieces, frames):
        return None
    frames.ignore(mask)
    return path, mask


def find_depth(
    job: Job,
    reading: ReadingResult,
    path: CameraPath,
    focal_deviation: float,  # relative standard deviation of the focal length
) -> DepthResult:
    """Find and write the depth of frames, piece by piece; poses get the unit of the depth."""
    count = len(reading.names)
    poses = np.full((count, 4, 4), np.nan)
    pieces = np.full(count, -1, np.int32)
    status: list[Status] = [Status("converged")] * count
    for frame, reason in path.missing.items():
        status[frame] = reason
    keyframes: list[int] = []
    errors, shares = np.full(count, np.nan), np.zeros(count)
    done = 0
    for number, piece in enumerate(path.pieces):
        if piece.only_turns:
            origin = piece.poses[min(piece.poses)]
            for frame, pose in piece.poses.items():
                poses[frame], pieces[frame] = np.linalg.solve(origin, pose), number
                status[frame] = ONLY_TURNS
            done += len(piece.poses)
            continue
        piece = _adjust_poses(job, reading.frames, piece, path.observations)
        kinds, unit, piece_errors = _piece_depth(
            job, reading.frames, piece, path.observations, done, focal_deviation
        )
        for frame, (error, share) in piece_errors.items():
            errors[frame], shares[frame] = error, share
        is_without_depth = job.depth_of == "keyframes" and not kinds
        done += len(piece.poses)
        keyframes += [frame for frame, kind in kinds.items() if kind == "keyframe"]
        origin = np.eye(4) if job.poses is not None else piece.poses[min(piece.poses)]
        for frame, pose in piece.poses.items():
            poses[frame], pieces[frame] = np.linalg.solve(origin, pose), number
            poses[frame, :3, 3] /= unit
            if frame not in kinds and (job.depth_of == "all" or is_without_depth):
                status[frame] = NO_PARALLAX
        if number > 0:
            first = min(piece.poses)
            status[first] = add_piece_note(status[first])
    return DepthResult(
        poses=poses,
        piece=pieces,
        status=tuple(status),
        keyframes=tuple(sorted(keyframes)),
        error=errors,
        share=shares,
    )


def check_pieces(
    job: Job, frames: PreparedFrames, path: CameraPath, depth: DepthResult
) -> tuple[PathCheck, ...]:
    """Check every piece of the path, and its depth, against the image motion."""

    def static_pixels(frame: int) -> np.ndarray:
        used_pixels = frames.used_pixels(frame)
        return np.ones(frames.shape, bool) if used_pixels is None else used_pixels

    def inverse_depth(frame: int) -> np.ndarray | None:
        is_written = job.depth_of != "none" and depth_path(job.folder, frame).exists()
        return read_depth(job.folder, frame, frames.shape)[0] if is_written else None

    return tuple(
        UNCHECKED
        if piece.only_turns
        else check_piece(
            {frame: depth.poses[frame] for frame in piece.poses},
            [frame for frame in depth.keyframes if frame in piece.poses],
            path.observations,
            frames.grey,
            static_pixels,
            inverse_depth,
            frames.camera,
        )
        for piece in path.pieces
    )


def write_result(
    job: Job,
    reading: ReadingResult,
    path_result: PathResult,
    calibration: Calibration,
    depth: DepthResult,
    checks: tuple[PathCheck, ...],
) -> Reconstruction:
    """Write the camera, the moving objects with their depth, and then the record."""
    about = as_json(calibration)
    del about["shape"]  # the camera file already has the width and the height
    write_camera(job.folder / CAMERA, path_result.camera, reading.camera.shape, about=about)
    objects: tuple[MovingObject, ...] = ()
    errors, shares = depth.error.copy(), depth.share.copy()
    if job.has_objects:
        from tisfm.reconstruction.objects.object_depth import objects_with_depth

        objects = objects_with_depth(
            reading.frames,
            job.folder,
            *_known_positions(path_result.path, depth),
            job.settings,
            with_depth=job.depth_of != "none",
            sizes=job.object_sizes,
        )
        for frame in {frame for obj in objects for frame in obj.frames}:
            if not np.isnan(errors[frame]):  # objects changed its depth
                depth_of_frame = read_depth(job.folder, frame, reading.frames.shape)
                errors[frame], shares[frame] = depth_error(
                    *depth_of_frame, calibration.relative_focal_std
                )
    result = Reconstruction(
        poses=depth.poses,
        piece=depth.piece,
        unit=(1.0,) * len(path_result.path.pieces),
        status=mark_uncertain(
            mark_contradicted(
                depth.status,
                depth.piece.tolist(),
                checks,
                _contradiction_causes(reading.frames, path_result.path, checks),
                path_result.path.objection,
            ),
            errors,
        ),
        depth_error=errors,
        depth_share=shares,
        checks=checks,
        keyframes=depth.keyframes,
        camera=reading.frames.camera,
        calibration=calibration,
        zoom=path_result.zoom,
        settings=job.settings,
        names=reading.names,
        times=reading.times,
        skipped=tuple(job.source.skipped),
        notes=reading.notes,
        shape=reading.frames.shape,
        folder=job.folder,
        version=__version__,
        objects=objects,
    )
    if path_result.fixed_pixels is not None:
        write_mask(job.folder, path_result.fixed_pixels)
    write_record(job.folder, result)
    return result


def _contradiction_causes(
    frames: PreparedFrames, path: CameraPath, checks: Sequence[PathCheck]
) -> dict[int, Status]:
    """Return what hides the motion in contradicted pieces, by piece, if the images show it."""
    search = CauseSearch(
        observations=path.observations,
        views=(),
        matches={},
        camera=frames.camera.pinhole(),
        shape=frames.shape,
        grey=lambda frame: frames.tracker_input(frame)[0],
    )
    causes = {
        number: search.find_image_cause(sorted(piece.poses))
        for number, (piece, check) in enumerate(zip(path.pieces, checks, strict=True))
        if check.contradicts
    }
    return {number: cause for number, cause in causes.items() if cause is not None}


def _known_positions(path: CameraPath, depth: DepthResult) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses and the pieces of frames, NaN and −1 where the camera only turns."""
    turning = [number for number, piece in enumerate(path.pieces) if piece.only_turns]
    is_unknown = np.isin(depth.piece, turning)
    poses = np.where(is_unknown[:, None, None], np.nan, depth.poses)
    return poses, np.where(is_unknown, np.int32(-1), depth.piece)


def _make_tracker(job: Job, camera: Camera, calibrate: Calibrate) -> SequenceTracker:
    return SequenceTracker(
        camera, is_focal_known=calibrate == "nothing", selects_views=job.poses is None
    )


def _solve_or_take_path(
    job: Job, reading: ReadingResult, tracks: SequenceTracks, calibrate: Calibrate
) -> CameraPath:
    """Return the path from tracks, or the given path with triangulated tracks."""
    camera = reading.frames.camera
    if job.poses is not None:
        return given_path(tracks, job.poses, camera, reading.times, reading.instants)
    readout = camera.readout
    if job.has_objects:  # a known readout is corrected; an unknown readout is not estimated
        readout = readout or 0.0
    solver = PathSolver(
        tracks=tracks,
        camera=camera,
        calibrate=calibrate,
        max_deviation=reading.camera.max_focal_deviation,
        readout=readout,
        is_focal_known=job.calibrate == "nothing" and reading.camera.is_focal_known,
        grey=lambda frame: reading.frames.tracker_input(frame)[0],
    )
    path = solver.solve(reading.instants)
    if not job.revises_camera:
        return path
    is_pinhole = reading.camera.full_camera.distortion is None
    return revise_path(path, solver, reading.instants, may_distort=is_pinhole)


def _label_all_frames(job: Job, reading: ReadingResult) -> None:
    """Label the frames without given labels, from the frames with given labels."""
    if not reading.labelled_frames:
        raise InputError(
            f"labels has no labels for a selected frame of {job.source.title}: expected labels "
            "for at least one"
        )
    label_remaining_frames(reading.frames, reading.labelled_frames)
    # The ids are checked before the long computation.
    refuse_unknown_ids(job.object_sizes, reading.frames.object_ids())


def _calibration(job: Job, reading: ReadingResult, path_result: PathResult) -> Calibration:
    """Return the origin and uncertainty of the camera; warn if it is unreliable."""
    rolling = path_result.path.rolling
    # A given readout has deviation 0.
    is_readout_estimated = rolling is not None and bool(rolling.deviation)
    calibration = reading.camera.calibration(
        path_result.path.focal,
        reading.frames.camera,
        is_estimated=job.calibrate != "nothing",
        focal=path_result.camera.focal,
        zoom=path_result.zoom,
        readout=(rolling.readout, rolling.deviation) if rolling and is_readout_estimated else None,
    )
    if not calibration.seen:
        warnings.warn(calibration.message, GuessedFocalWarning, stacklevel=4)
    return calibration


def _adjust_poses(
    job: Job, frames: PreparedFrames, piece: Piece, observations: Sequence[Observations]
) -> Piece:
    """Return the piece with poses adjusted to the images, if the settings ask for accuracy."""
    from tisfm.reconstruction.depth.pose_adjustment import adjust_poses
    from tisfm.reconstruction.depth.segment_depth import PieceDepths, depth_effort

    if job.poses is not None or depth_effort(job.settings) != "accurate":
        return piece
    windows = PieceDepths(
        frames, piece, observations, job.settings, effort="fast"
    ).keyframe_windows()
    poses = adjust_poses(piece.poses, windows, frames.grey, frames.camera, job.settings)
    return replace(piece, poses=poses)


def _piece_depth(
    job: Job,
    frames: PreparedFrames,
    piece: Piece,
    observations: Sequence[Observations],
    done: int,  # number of frames of earlier pieces
    focal_deviation: float,  # relative standard deviation of the focal length
) -> tuple[dict[int, str], float, dict[int, tuple[float, float]]]:
    """Write the depth of a piece's frames.

    Returns the kind of each frame, "keyframe" or "between"; the unit; and `depth_error` of each
    frame.
    """
    if job.depth_of == "none":
        return {}, median_track_depth(piece, observations), {}
    from tisfm.reconstruction.depth.segment_depth import PieceDepths, depth_effort, median_depth

    depths = PieceDepths(
        frames,
        piece,
        observations,
        job.settings,
        effort=depth_effort(job.settings),
        written_until=max(piece.poses) if job.depth_of == "keyframes" else -1,
    )
    kinds: dict[int, str] = {}
    errors: dict[int, tuple[float, float]] = {}
    unit = 1.0
    for depth in depths:
        if not kinds and job.poses is None:
            unit = median_depth(depth.inverse_depth)
        write_depth(job.folder, depth.frame, depth.inverse_depth * unit, depth.deviation * unit)
        errors[depth.frame] = depth_error(depth.inverse_depth, depth.deviation, focal_deviation)
        job.report_depth(depth.frame, errors[depth.frame][0])
        kinds[depth.frame] = "keyframe" if depth.frame in depths.keyframes else "between"
        job.progress("depth", done + len(kinds), len(observations))
    if not kinds and job.poses is None:
        unit = median_track_depth(piece, observations)
    return kinds, unit, errors


def median_track_depth(piece: Piece, observations: Sequence[Observations]) -> float:
    """Return the median depth of tracks in the first frame of a piece with tracks, or 1."""
    for frame, pose in piece.poses.items():
        _, depths = track_depths(observations[frame], piece.points, pose)
        if len(depths):
            return float(np.median(depths))
    return 1.0


def _frame_count(source: FrameSource) -> int | None:
    try:
        return len(source) + 1
    except TypeError:
        return None


def _distinct_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of frames, with a number before each name if two names are equal."""
    all_names = list(names)
    if len(set(all_names)) == len(all_names):
        return tuple(all_names)
    return tuple(f"{k:06d}_{name}" for k, name in enumerate(all_names))
