"""The fourth stage: checks of the path and its depth against the image motion."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.causes.cause import MISLEADING_CAUSES
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path_checks.pieces import check_piece
from tisfm.reconstruction.result.folder import depth_path, read_depth
from tisfm.reconstruction.result.path_check import UNCHECKED, PathCheck
from tisfm.reconstruction.stages.depth import DepthResult
from tisfm.reconstruction.stages.job import Job


def check_pieces(
    job: Job, frames: PreparedFrames, path: CameraPath, depth: DepthResult
) -> tuple[PathCheck, ...]:
    """Check every piece of the path, and its depth, against the image motion."""

    def inverse_depth(frame: int) -> np.ndarray | None:
        is_written = job.depth_of != "none" and depth_path(job.folder, frame).exists()
        return read_depth(job.folder, frame, frames.shape)[0] if is_written else None

    return tuple(
        _check_piece(
            frames,
            path,
            piece,
            {frame: depth.poses[frame] for frame in piece.poses},
            [frame for frame in depth.keyframes if frame in piece.poses],
            inverse_depth,
            frames.camera,
        )
        for piece in path.pieces
    )


def check_path(frames: PreparedFrames, path: CameraPath) -> tuple[PathCheck, ...]:
    """Check every piece of a path whose depth is unknown."""
    return tuple(
        _check_piece(frames, path, piece, piece.poses, (), lambda _: None, path.camera.pinhole())
        for piece in path.pieces
    )


def agrees_with_images(frames: PreparedFrames, path: CameraPath) -> bool:
    """Return whether the image motion of the unlabelled pixels contradicts no piece of a path."""
    return not any(check.contradicts for check in check_path(frames, path))


def _check_piece(
    frames: PreparedFrames,
    path: CameraPath,
    piece: Piece,
    poses: Mapping[int, np.ndarray],  # of the piece, by frame
    keyframes: Sequence[int],  # of the piece
    inverse_depth: Callable[[int], np.ndarray | None],  # frame → (H, W)
    camera: Camera,  # a pinhole
) -> PathCheck:
    if piece.only_turns or path.has_photographs:
        return UNCHECKED

    return check_piece(
        poses,
        keyframes,
        path.observations,
        frames.grey,
        frames.static_pixels,
        inverse_depth,
        camera,
        frames.kept_flow,
        piece.views,
        piece.joints,
    )


def find_contradiction_causes(
    frames: PreparedFrames, path: CameraPath, checks: Sequence[PathCheck]
) -> dict[int, str]:
    """Return what hides the motion, by piece, in pieces that are contradicted or in doubt.

    A doubt counts beside noise, a fixed pattern or changing light only: these mislead tracks.
    """
    search = CauseSearch.of_images(
        path.observations,
        frames.camera,
        frames.shape,
        lambda frame: frames.tracker_input(frame)[0],
    )
    causes = {
        number: search.find_image_cause(sorted(piece.poses))
        for number, (piece, check) in enumerate(zip(path.pieces, checks, strict=True))
        if check.contradicts or check.doubt
    }
    return {
        number: cause.message
        for number, cause in causes.items()
        if cause is not None and (checks[number].contradicts or cause in MISLEADING_CAUSES)
    }
