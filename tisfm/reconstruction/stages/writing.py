"""The last stage: the files of the result."""

import numpy as np

from tisfm.camera_file import FILE_NAME as CAMERA
from tisfm.camera_file import write_camera
from tisfm.grade import depth_error
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.result.calibration import Calibration, as_json
from tisfm.reconstruction.result.folder import read_depth, write_mask, write_record
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.statuses import (
    mark_contradicted,
    mark_doubtful,
    mark_uncertain,
)
from tisfm.reconstruction.stages.checks import find_contradiction_causes
from tisfm.reconstruction.stages.depth import DepthResult
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.path import PathResult
from tisfm.reconstruction.stages.reading import ReadingResult
from tisfm.status import Status
from tisfm.version import __version__


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
    if job.has_objects:
        from tisfm.reconstruction.objects.object_depth import objects_with_depth

        objects = objects_with_depth(
            reading.frames,
            job.folder,
            *_known_positions(path_result.path, depth),
            job.settings,
            with_depth=job.depth_of != "none",
            sizes=job.object_sizes,
            given_labels=frozenset(reading.labelled_frames),
        )
    errors, shares = _find_depth_errors(job, reading, calibration, depth, checks, objects)
    result = Reconstruction(
        poses=depth.poses,
        piece=depth.piece,
        unit=(1.0,) * len(path_result.path.pieces),
        position_deviation=depth.position_deviation,
        rotation_deviation=depth.rotation_deviation,
        status=_find_statuses(reading, path_result.path, depth, checks, errors),
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


def _find_depth_errors(
    job: Job,
    reading: ReadingResult,
    calibration: Calibration,
    depth: DepthResult,
    checks: tuple[PathCheck, ...],
    objects: tuple[MovingObject, ...],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the expected error of depth and the share of good pixels of each frame, (N,) each.

    They change where objects changed the depth, and in pieces whose path fits the images worse than
    another motion does.
    """
    errors, shares = depth.error.copy(), depth.share.copy()
    changed_frames = {frame for obj in objects for frame in obj.frames}
    for frame, piece in enumerate(depth.piece.tolist()):
        factor = checks[piece].residual_factor if piece >= 0 else 1.0
        if np.isnan(errors[frame]) or (factor == 1 and frame not in changed_frames):
            continue
        depth_of_frame = read_depth(job.folder, frame, reading.frames.shape)
        errors[frame], shares[frame] = depth_error(
            *depth_of_frame, calibration.relative_focal_std, residual_factor=factor
        )
    return errors, shares


def _find_statuses(
    reading: ReadingResult,
    path: CameraPath,
    depth: DepthResult,
    checks: tuple[PathCheck, ...],
    errors: np.ndarray,  # (N,): expected relative errors of depth, NaN without depth
) -> tuple[Status, ...]:
    """Return the statuses of frames: the checks, doubts and deviations may change them."""
    pieces = depth.piece.tolist()
    causes = find_contradiction_causes(reading.frames, path, checks)
    statuses = mark_contradicted(depth.status, pieces, checks, causes, path.objection)
    return mark_uncertain(mark_doubtful(statuses, pieces, path.doubts), errors)


def _known_positions(path: CameraPath, depth: DepthResult) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses and the pieces of frames, NaN and −1 where the camera only turns."""
    turning = [number for number, piece in enumerate(path.pieces) if piece.only_turns]
    is_unknown = np.isin(depth.piece, turning)
    poses = np.where(is_unknown[:, None, None], np.nan, depth.poses)
    return poses, np.where(is_unknown, np.int32(-1), depth.piece)
