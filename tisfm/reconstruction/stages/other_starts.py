"""Another start of the path, where the image motion contradicts its direction.

A path begins with two views, and tracks may give them a wrong motion: beside repeated patterns, or
where little parallax lets several motions pass. The dense image motion of the checks is computed
without the path. So its motion of two views is another start, and the checks judge the new path.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.camera_revision import revise_path
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.path_checks.dense_pairs import find_dense_pair
from tisfm.reconstruction.path_checks.settings import PATH_CHECKS
from tisfm.reconstruction.result.folder import depth_path
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.stages.checks import check_path
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.path import PathResult
from tisfm.reconstruction.stages.reading import ReadingResult
from tisfm.reconstruction.submaps.settings import SUBMAPS
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks


def start_elsewhere(
    job: Job, reading: ReadingResult, first: PathResult, checks: Sequence[PathCheck]
) -> PathResult | None:
    """Return a path that begins with the dense motion of two views, and that no check contradicts.

    The result is None if the checks do not contradict the direction of the first path, if its focal
    length is an estimate, or if they contradict each new path, too. Otherwise the depth of the
    first path is deleted.
    """
    tracks, path = reading.tracks, first.path
    if not job.revises_camera or tracks is None or first.fixed_pixels is not None:
        return None
    # A focal length that was estimated with the wrong motion is wrong, too.
    is_simple = path.is_plain and path.focal is None and len(tracks.views) <= SUBMAPS.max_views
    if not is_simple or len(path.pieces) != 1 or path.pieces[0].joints:
        return None
    if not is_direction_wrong(checks[0]):
        return None
    frames = reading.frames
    job.progress("path", 0, frames.count)  # the stage begins again
    new_path = _find_other_path(reading, tracks, path, checks[0])
    job.progress("path", frames.count, frames.count)
    if new_path is None:
        return None
    for number in range(frames.count):
        depth_path(job.folder, number).unlink(missing_ok=True)
    return replace(first, path=new_path)


def _find_other_path(
    reading: ReadingResult, tracks: SequenceTracks, path: CameraPath, check: PathCheck
) -> CameraPath | None:
    """Return the first path from another start that no check contradicts, or None."""
    frames = reading.frames
    for start in _find_starts(frames, path, check):
        solver = PathSolver(
            tracks=tracks,
            camera=path.camera,
            readout=0.0,
            is_focal_known=reading.camera.is_focal_known,
            grey=lambda frame: frames.tracker_input(frame)[0],
            start=start,
        )
        new_path = solver.solve(reading.instants)
        is_whole = len(new_path.pieces_with_positions) == 1 == len(new_path.pieces)
        if not is_whole or new_path.missing.keys() - path.missing.keys():
            continue
        (new_check,) = check_path(frames, new_path)
        if new_check.contradicts or "direction" in new_check.objections or not new_check.pairs:
            continue
        # A plane leaves its second motion possible for the new start, too.
        piece = replace(new_path.pieces[0], rival=path.pieces[0].rival)
        new_path = replace(new_path, pieces=(piece,))
        revised = revise_path(new_path, solver, reading.instants, may_distort=False)
        if revised.is_plain and not revised.objection:
            return revised
    return None


def is_direction_wrong(check: PathCheck) -> bool:
    """Return whether a check contradicts a path, and its direction of motion."""
    return check.contradicts and "direction" in check.objections


def _find_starts(
    frames: PreparedFrames, path: CameraPath, check: PathCheck
) -> Iterator[Mapping[int, np.ndarray]]:
    """Yield the poses of two views, by frame, from their dense motion.

    Pairs with much parallax and a small deviation of its direction come first.
    """
    views = np.array(path.pieces[0].views)
    pairs = sorted(check.pairs, key=lambda pair: -pair.parallax / max(pair.direction_deviation, 1))
    tried: set[tuple[int, int]] = set()
    for pair in pairs:
        first, second = (
            int(views[np.argmin(np.abs(views - frame))]) for frame in (pair.first, pair.second)
        )
        if first == second or (first, second) in tried:
            continue
        tried.add((first, second))
        dense = find_dense_pair(
            (first, frames.grey(first)),
            (second, frames.grey(second)),
            np.linalg.inv(path.pieces[0].poses[second]) @ path.pieces[0].poses[first],
            path.camera,
            frames.static_pixels(first),
        )
        if dense is not None:
            rotation, translation = dense.free
            motion = np.eye(4)
            motion[:3, :3], motion[:3, 3] = rotation, translation
            yield {first: np.eye(4), second: np.linalg.inv(motion)}
        if len(tried) == PATH_CHECKS.max_starts:
            return
