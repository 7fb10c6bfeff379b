"""Pieces of frames without a pose in which the camera only turns."""

from dataclasses import replace

from tisfm.reconstruction.mapping.solution import PathSolution
from tisfm.reconstruction.path.missing_poses import split_runs
from tisfm.reconstruction.path.undistortion import undistort_views
from tisfm.reconstruction.rotation.rotation_search import RotationSearch
from tisfm.reconstruction.rotation.settings import ROTATION
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks


def add_turning_pieces(
    solution: PathSolution,
    tracks: SequenceTracks,
    *,
    # whether the focal length is not estimated; it is known as well if there is another piece
    is_focal_known: bool,
    max_deviation: float,  # as for `PathSolver`
) -> PathSolution:
    """Return the solution with pieces in which the camera only turns.

    If there is no other piece, and the focal length is to be estimated, the rotations show it.
    """
    runs = [run for run in split_runs(solution.missing_frames) if len(run) >= ROTATION.min_frames]
    if not runs:
        return solution
    is_focal_known = is_focal_known or bool(solution.pieces)
    search = RotationSearch(
        observations=solution.observations,
        views=undistort_views(solution.views, solution.camera, tracks.shape),
        matches=tracks.matches,
        camera=solution.camera.pinhole(),
        shape=tracks.shape,
        max_deviation=max_deviation,
    )
    while runs:
        run = runs.pop(0)
        found = search.find_piece(run, is_focal_known=is_focal_known)
        if found is None:
            continue
        piece, estimate = found
        solution = replace(
            solution,
            pieces=[*solution.pieces, piece],
            missing_frames=[k for k in solution.missing_frames if k not in piece.poses],
        )
        rest = [frame for frame in run if frame not in piece.poses]
        if len(rest) >= ROTATION.min_frames:  # another pan, as after a cut
            runs.insert(0, rest)
        if estimate is not None:  # of the first run; later runs have this focal length too
            solution = replace(solution, camera=estimate.apply_to(solution.camera), focal=estimate)
            search = replace(search, camera=solution.camera.pinhole())
            is_focal_known = True
    return solution
