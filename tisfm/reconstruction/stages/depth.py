"""The third stage: the depth of frames, in the scale of the path."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tisfm.grade import GRADES, depth_error
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.pose_deviation import PoseDeviations, find_pose_deviations
from tisfm.reconstruction.result.folder import write_depth
from tisfm.reconstruction.result.statuses import NO_PARALLAX, ONLY_TURNS, add_piece_note
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.reading import ReadingResult
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import track_depths
from tisfm.status import Status


@dataclass(frozen=True, kw_only=True)
class DepthResult:
    """Poses in the unit of depth, after the depth of all frames was written."""

    poses: np.ndarray  # (N, 4, 4) float64: camera to world; NaN for a frame without a pose
    piece: np.ndarray  # (N,) int32: the piece of each frame, −1 for none
    # (N, 3) float64: standard deviations of the poses, as `Reconstruction` describes them
    position_deviation: np.ndarray
    rotation_deviation: np.ndarray
    status: tuple[Status, ...]
    keyframes: tuple[int, ...]
    # (N,) float64: expected relative error of the depth of each frame, NaN without depth, and the
    # share of good pixels, as `tisfm.grade.depth_error` returns them
    error: np.ndarray
    share: np.ndarray


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
    position_deviation, rotation_deviation = np.full((2, count, 3), np.nan)
    done = 0
    for number, piece in enumerate(path.pieces):
        if piece.only_turns:
            origin = piece.poses[min(piece.poses)]
            for frame, pose in piece.poses.items():
                poses[frame], pieces[frame] = np.linalg.solve(origin, pose), number
                status[frame] = ONLY_TURNS
            done += len(piece.poses)
            continue
        deviations = _find_pose_deviations(job, reading.frames, path, piece, focal_deviation)
        piece = _adjust_poses(job, reading.frames, piece, path.observations)
        kinds, unit, piece_errors = _write_piece_depth(
            job, reading.frames, piece, path.observations, done, focal_deviation, deviations
        )
        for frame, (error, share) in piece_errors.items():
            errors[frame], shares[frame] = error, share
        if deviations is not None:
            members = list(deviations.frames)
            position_deviation[members] = deviations.position / unit
            rotation_deviation[members] = deviations.rotation
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
        position_deviation=position_deviation,
        rotation_deviation=rotation_deviation,
        status=tuple(status),
        keyframes=tuple(sorted(keyframes)),
        error=errors,
        share=shares,
    )


def _find_pose_deviations(
    job: Job,
    frames: PreparedFrames,
    path: CameraPath,
    piece: Piece,
    focal_deviation: float,  # relative standard deviation of the focal length
) -> PoseDeviations | None:
    """Return the deviations of the poses of a piece; 0 if poses were given, None if unknown."""
    if job.poses is not None:
        zero = np.zeros((len(piece.poses), 3))
        return PoseDeviations(
            frames=tuple(piece.poses), position=zero, rotation=zero, relative_depth=zero[:, 0]
        )
    deviation = min(focal_deviation, GRADES.guessed_focal_deviation)
    return find_pose_deviations(path, piece, frames.shape, deviation)


def _adjust_poses(
    job: Job, frames: PreparedFrames, piece: Piece, observations: Sequence[Observations]
) -> Piece:
    """Return the piece with poses adjusted to the images: of a plane, or for accuracy."""
    from tisfm.reconstruction.depth.plane_alignment import align_plane
    from tisfm.reconstruction.depth.pose_adjustment import adjust_poses
    from tisfm.reconstruction.depth.segment_depth import PieceDepths, depth_effort

    if job.poses is not None:
        return piece
    aligned = align_plane(
        piece.poses,
        piece.points,
        observations,
        frames.grey,
        frames.static_pixels,
        frames.camera,
        frames.shape,
    )
    if aligned is not None:
        return replace(piece, poses=aligned)
    if depth_effort(job.settings) != "accurate":
        return piece
    windows = PieceDepths(
        frames, piece, observations, job.settings, effort="fast"
    ).keyframe_windows()
    poses = adjust_poses(piece.poses, windows, frames.grey, frames.camera, job.settings)
    return replace(piece, poses=poses)


def _write_piece_depth(
    job: Job,
    frames: PreparedFrames,
    piece: Piece,
    observations: Sequence[Observations],
    done: int,  # number of frames of earlier pieces
    focal_deviation: float,  # relative standard deviation of the focal length
    pose_deviations: PoseDeviations | None,
) -> tuple[dict[int, str], float, dict[int, tuple[float, float]]]:
    """Write the depth of a piece's frames.

    Returns the kind of each frame, "keyframe" or "between"; the unit; and `depth_error` of each
    frame.
    """
    if job.depth_of == "none":
        return {}, _find_median_track_depth(piece, observations), {}
    from tisfm.reconstruction.depth.segment_depth import PieceDepths, depth_effort, median_depth

    depths = PieceDepths(
        frames,
        piece,
        observations,
        job.settings,
        effort=depth_effort(job.settings),
        written_until=max(piece.poses) if job.depth_of == "keyframes" else -1,
    )
    of_poses = _find_pose_effects(piece, pose_deviations)
    kinds: dict[int, str] = {}
    errors: dict[int, tuple[float, float]] = {}
    unit = 1.0
    for depth in depths:
        if not kinds and job.poses is None:
            unit = median_depth(depth.inverse_depth)
        deviation = np.hypot(
            depth.deviation, np.float32(of_poses[depth.frame]) * depth.inverse_depth
        )
        write_depth(job.folder, depth.frame, depth.inverse_depth * unit, deviation * unit)
        errors[depth.frame] = depth_error(depth.inverse_depth, deviation, focal_deviation)
        job.report_depth(depth.frame, errors[depth.frame][0])
        kinds[depth.frame] = "keyframe" if depth.frame in depths.keyframes else "between"
        job.progress("depth", done + len(kinds), len(observations))
    if not kinds and job.poses is None:
        unit = _find_median_track_depth(piece, observations)
    return kinds, unit, errors


def _find_pose_effects(piece: Piece, deviations: PoseDeviations | None) -> dict[int, float]:
    """Return the relative standard deviation of depth because of the poses, for every frame.

    A frame whose own is unknown has the largest of the piece. It is 0 if all are unknown.
    """
    known: dict[int, float] = {}
    if deviations is not None:
        pairs = zip(deviations.frames, deviations.relative_depth.tolist(), strict=True)
        known = {frame: value for frame, value in pairs if np.isfinite(value)}
    return dict.fromkeys(piece.poses, max(known.values(), default=0.0)) | known


def _find_median_track_depth(piece: Piece, observations: Sequence[Observations]) -> float:
    """Return the median depth of tracks in the first frame of a piece with tracks, or 1."""
    for frame, pose in piece.poses.items():
        _, depths = track_depths(observations[frame], piece.points, pose)
        if len(depths):
            return float(np.median(depths))
    return 1.0
