"""Poses of the frames between views, from the points of the pieces beside them."""

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.models import pose_from_points
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.tracks.tracker import Observations


def add_remaining_frames(
    pieces: Sequence[Piece],
    observations: Sequence[Observations],  # tracks in every frame
    frames: Iterable[int],  # frames to add
    camera: Camera,  # pinhole camera of the frames
    shape: tuple[int, int],  # height and width of the frames, px
) -> tuple[list[Piece], list[int]]:
    """Add the frames between views to pieces; return the pieces and the frames without a piece."""
    piece_of_frame = {frame: k for k, piece in enumerate(pieces) for frame in piece.poses}
    sorted_frames = sorted(piece_of_frame)
    poses_of_pieces: list[dict[int, np.ndarray]] = [dict(piece.poses) for piece in pieces]
    missing_frames = []
    for frame in frames:
        if frame in piece_of_frame:
            continue
        for k in _find_nearest_pieces(frame, piece_of_frame, sorted_frames):
            pose = pose_from_points(observations[frame], pieces[k].points, camera, shape)
            if pose is not None:
                poses_of_pieces[k][frame] = pose
                break
        else:
            missing_frames.append(frame)
    return [
        replace(piece, poses=dict(sorted(poses.items())))
        for piece, poses in zip(pieces, poses_of_pieces, strict=True)
    ], missing_frames


def _find_nearest_pieces(
    frame: int, piece_of_frame: Mapping[int, int], sorted_frames: Sequence[int]
) -> list[int]:
    """Return the pieces of the nearest frames before and after a frame, without repetition."""
    after = bisect_left(sorted_frames, frame)
    neighbours = [*sorted_frames[max(0, after - 1) : after], *sorted_frames[after : after + 1]]
    neighbours.sort(key=lambda other: abs(other - frame))
    return list(dict.fromkeys(piece_of_frame[other] for other in neighbours))
