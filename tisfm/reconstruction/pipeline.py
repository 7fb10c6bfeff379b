"""The pipeline of a whole sequence: read → track → solve → depth → check → write.

Each stage takes the frozen results of earlier stages, and returns its own result. Prepared frames
and depth are too large for memory: they are stored in the folder of the result.
"""

from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.stages.checks import check_pieces
from tisfm.reconstruction.stages.depth import find_depth
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.path import find_calibration, solve_path
from tisfm.reconstruction.stages.reading import read_frames
from tisfm.reconstruction.stages.writing import write_result


def reconstruct_sequence(job: Job) -> Reconstruction:
    """Run all stages."""
    reading = read_frames(job)
    path_result = solve_path(job, reading)
    calibration = find_calibration(job, reading, path_result)
    depth = find_depth(job, reading, path_result.path, calibration.relative_focal_std)
    checks = check_pieces(job, reading.frames, path_result.path, depth)
    return write_result(job, reading, path_result, calibration, depth, checks)
