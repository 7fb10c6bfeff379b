"""The second stage: the camera path, and corrections of frames that follow from it."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels, label_remaining_frames
from tisfm.reconstruction.objects.static_path import find_static_path
from tisfm.reconstruction.path.camera_path import FAR_APART, CameraPath
from tisfm.reconstruction.path.camera_revision import revise_path
from tisfm.reconstruction.path.given_path import take_given_path
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.path_checks.fixed_texture import camera_turns, find_fixed_pixels
from tisfm.reconstruction.result.calibration import Calibrate, Calibration
from tisfm.reconstruction.result.moving_object import refuse_unknown_ids
from tisfm.reconstruction.stages.checks import agrees_with_images
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.reading import ReadingResult, make_tracker
from tisfm.reconstruction.tracks.photographs import are_photographs, match_photographs
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks


@dataclass(frozen=True, kw_only=True)
class PathResult:
    """The camera path, and the camera that was estimated with the path."""

    path: CameraPath
    camera: Camera  # camera of the frames of the source, before crop and reduction
    # (H, W) bool, or None: pixels that are fixed on the sensor, and masked in all frames
    fixed_pixels: np.ndarray | None = None
    # (N,) float64: focal length of each frame over that of `camera`; None if it is constant
    zoom: np.ndarray | None = None


def solve_path(
    job: Job,
    reading: ReadingResult,
    search: SequenceLabels | None = None,  # of all frames: labels moving pixels, which are ignored
    choose: Callable[[CameraPath], CameraPath] = lambda path: path,  # the path that is used instead
) -> PathResult:
    """Find the camera path, or use given poses; correct frames for the estimated lens and readout.

    With moving objects or a search for them, every frame is labelled as well.
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
        return choose(_track_and_solve(job, reading, calibrate or job.calibrate))

    if search is not None:
        path = find_static_path(frames, search, solve_static_path, correct)
    elif reading.tracks is not None:
        if masked := _mask_fixed_pixels(job, reading):
            path, mask = masked
        else:
            path = _find_path(job, reading, reading.tracks, job.calibrate)
        correct(path)
    else:
        labels, plain_path = reading.labels, None
        if masked := _mask_fixed_pixels(job, reading):
            plain_path, mask = masked
            if labels is not None:
                labels = SequenceLabels.of_frames(frames)
        if labels is None:
            _label_all_frames(job, reading)
        path = find_static_path(
            frames,
            labels,
            solve_static_path,
            correct,
            lambda path: agrees_with_images(frames, path),
            plain_path,
        )
        refuse_unknown_ids(job.object_sizes, frames.object_ids())
    job.progress("path", len(reading.names), len(reading.names))
    return PathResult(path=path, camera=full_camera, fixed_pixels=mask, zoom=path.zoom)


def _track_and_solve(
    job: Job, reading: ReadingResult, calibrate: Calibrate, mask: np.ndarray | None = None
) -> CameraPath:
    """Return the path from new tracks; pixels of a mask, (H, W) bool, have no tracks."""
    frames = reading.frames
    tracker = make_tracker(job, frames.camera, calibrate)
    for number in range(frames.count):
        grey, ignored = frames.tracker_input(number)
        tracker.add(grey, _join_masks(ignored, mask), frames.flow(number))
    return _find_path(job, reading, tracker.finish(), calibrate, mask)


def _join_masks(ignored: np.ndarray | None, mask: np.ndarray | None) -> np.ndarray | None:
    """Return the pixels that one of two masks ignores, (H, W) bool; None for none."""
    if ignored is None or mask is None:
        return mask if ignored is None else ignored
    return ignored | mask


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


def _find_path(
    job: Job,
    reading: ReadingResult,
    tracks: SequenceTracks,
    calibrate: Calibrate,
    mask: np.ndarray | None = None,  # (H, W) bool: pixels without tracks
) -> CameraPath:
    """Return the path from tracks, or the given path with triangulated tracks."""
    camera = reading.frames.camera
    photographs = None
    if are_photographs(tracks.observations):

        def frame_of(number: int) -> tuple[np.ndarray, np.ndarray | None]:
            grey, ignored = reading.frames.tracker_input(number)
            return grey, _join_masks(ignored, mask)

        photographs = match_photographs(
            tracks, frame_of, camera, is_focal_known=calibrate == "nothing"
        )
        tracks = photographs or tracks
    if job.poses is not None:
        path = take_given_path(tracks, job.poses, camera, reading.times, reading.instants)
        return replace(path, has_photographs=photographs is not None)
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
    if job.revises_camera:
        is_pinhole = reading.camera.full_camera.distortion is None
        path = revise_path(path, solver, reading.instants, may_distort=is_pinhole)
    if photographs is not None:
        doubt = "; ".join(filter(None, [path.doubt, FAR_APART]))
        path = replace(path, has_photographs=True, doubt=doubt)
    return path


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


def find_calibration(job: Job, reading: ReadingResult, path_result: PathResult) -> Calibration:
    """Return the origin and uncertainty of the camera."""
    rolling = path_result.path.rolling
    # A given readout has deviation 0.
    is_readout_estimated = rolling is not None and bool(rolling.deviation)
    return reading.camera.calibration(
        path_result.path.focal,
        reading.frames.camera,
        is_estimated=job.calibrate != "nothing",
        focal=path_result.camera.focal,
        zoom=path_result.zoom,
        readout=(rolling.readout, rolling.deviation) if rolling and is_readout_estimated else None,
    )


def warn_of_camera(calibration: Calibration) -> None:
    """Warn of an unreliable camera."""
    if not calibration.seen:
        warnings.warn(calibration.message, GuessedFocalWarning, stacklevel=4)
