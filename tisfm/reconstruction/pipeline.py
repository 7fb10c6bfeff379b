"""The pipeline of a whole sequence: read → track → solve → depth → check → write.

Each stage takes the frozen results of earlier stages, and returns its own result. Prepared frames
and depth are too large for memory: they are stored in the folder of the result.
"""

from dataclasses import replace

import numpy as np

from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.statuses import add_mask_notes
from tisfm.reconstruction.stages.checks import check_pieces
from tisfm.reconstruction.stages.depth import find_depth
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.moving_pixels import mask_moving_pixels
from tisfm.reconstruction.stages.other_starts import start_elsewhere
from tisfm.reconstruction.stages.path import find_calibration, solve_path, warn_of_camera
from tisfm.reconstruction.stages.reading import read_frames
from tisfm.reconstruction.stages.writing import write_result


def reconstruct_sequence(job: Job) -> Reconstruction:
    """Run all stages; again from another start, or without moving pixels, if checks object."""
    reading = read_frames(job)
    path_result = solve_path(job, reading)
    calibration = find_calibration(job, reading, path_result)
    if not job.revises_camera:  # the camera is final: warn before the long computation
        warn_of_camera(calibration)
    depth = find_depth(job, reading, path_result.path, calibration.relative_focal_std)
    checks = check_pieces(job, reading.frames, path_result.path, depth)
    restarted = start_elsewhere(job, reading, path_result, checks)
    if restarted is not None:
        path_result = restarted
        depth = find_depth(job, reading, path_result.path, calibration.relative_focal_std)
        checks = check_pieces(job, reading.frames, path_result.path, depth)
    masked = mask_moving_pixels(job, reading, path_result, checks)
    if masked is not None:
        path_result = masked.result
        calibration = find_calibration(job, reading, path_result)
        depth = find_depth(job, reading, path_result.path, calibration.relative_focal_std)
        statuses = add_mask_notes(
            depth.status, depth.piece.tolist(), masked.moving_shares, np.isfinite(depth.error)
        )
        depth = replace(depth, status=statuses)
        checks = check_pieces(job, reading.frames, path_result.path, depth)
    if job.revises_camera:
        warn_of_camera(calibration)
    return write_result(job, reading, path_result, calibration, depth, checks)
