"""Joints: consecutive pieces of a path that direct alignment brings into one coordinate system.

A piece of a path ends where too few points are tracked or matched, as beside repeated lines. The
images on both sides of the gap may still show the same surfaces. So the grey values around the
known points of each piece are aligned with the frames of the other piece. All patches share the
seven unknowns of a similarity, so lines suffice: no patch has to determine a motion by itself.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.camera import Camera
from tisfm.reconstruction.geometry.sim3 import sim3_scale, transform_points, transform_pose
from tisfm.reconstruction.joints.alignment import Aligner, Alignment, PieceEnd, start_similarity
from tisfm.reconstruction.joints.settings import JOINTS
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import TrackPoints, points_of_tracks


def join_pieces(
    pieces: Sequence[Piece],
    observations: Sequence[Observations],  # tracks in every frame
    camera: Camera,  # pinhole camera of the frames
    grey: Callable[[int], np.ndarray],  # frame → (H, W) uint8
) -> list[Piece]:
    """Return pieces, of which consecutive ones are joined where their images agree.

    A joined piece keeps the coordinates of its first part.
    """
    joined: list[Piece] = []
    for piece in sorted(pieces, key=lambda piece: min(piece.poses)):
        if joined and _are_consecutive(joined[-1], piece):
            earlier = _piece_end(joined[-1], observations, camera, grey, is_last=True)
            later = _piece_end(piece, observations, camera, grey, is_last=False)
            gap = min(piece.poses) - max(joined[-1].poses)
            if earlier and later and (similarity := find_joint(earlier, later, gap)) is not None:
                joined[-1] = _merge(joined[-1], piece, similarity)
                continue
        joined.append(piece)
    return joined


def find_joint(
    earlier: PieceEnd,
    later: PieceEnd,
    gap: int,  # number of frames from the last frame of the earlier piece to that of the later one
) -> np.ndarray | None:
    """Return the similarity, (4, 4), from the later to the earlier world; None for no joint."""
    if min(earlier.patch_count, later.patch_count) < JOINTS.min_points:
        return None
    aligner = Aligner(earlier=earlier, later=later)
    coarse = sorted(
        (aligner.align_coarsely(start) for start in _starts(earlier, later, gap)),
        key=lambda alignment: -alignment.score,
    )
    if coarse[0].score < JOINTS.min_coarse_score:
        return None
    best = aligner.refine(coarse[0].similarity)
    others = [each for each in coarse[1:] if _differ(each, coarse[0], earlier, later)]
    if others:
        best = max(best, aligner.refine(others[0].similarity), key=lambda each: each.score)
    is_certain = (
        _fits_well(best, earlier, later)
        and _agree(
            aligner.refine_one_way(best.similarity, shows_earlier=True),
            aligner.refine_one_way(best.similarity, shows_earlier=False),
        )
        and not _has_rival(best, aligner)
    )
    return best.similarity if is_certain else None


def _fits_well(alignment: Alignment, earlier: PieceEnd, later: PieceEnd) -> bool:
    own_score = min(earlier.own_score(), later.own_score())
    return (
        own_score > JOINTS.min_own_score
        and alignment.score > JOINTS.min_score * own_score
        and alignment.scale_deviation < JOINTS.max_scale_deviation
    )


def _has_rival(best: Alignment, aligner: Aligner) -> bool:
    """Return whether another similarity explains the images nearly as well.

    Repeated tiles give rivals: there the later piece may be shifted along the surface.
    """
    earlier, later = aligner.earlier, aligner.later
    for start in _shifted_starts(best.similarity, earlier, later):
        other = aligner.refine(start)
        is_as_good = other.score > JOINTS.min_rival_score * best.score
        if is_as_good and _differ(other, best, earlier, later):
            return True
    return False


def _shifted_starts(similarity: np.ndarray, earlier: PieceEnd, later: PieceEnd) -> list[np.ndarray]:
    """Return similarities that shift the later piece sideways, where the images agree best.

    They are local maxima of the mean correlation over a grid of shifts, at the coarsest level.
    """
    level = earlier.levels[0][-1]
    shape = level.image.shape
    unit = level.factor / earlier.camera.focal * earlier.median_depth  # of a pixel of this level
    rows, columns = (_shift_steps(side) for side in shape)
    shifted = np.tile(similarity, (len(rows), len(columns), 1, 1))
    scores = np.zeros((len(rows), len(columns)))
    for i, j in np.ndindex(scores.shape):
        shift = earlier.poses[0][:3, :3] @ (columns[j] * unit, rows[i] * unit, 0.0)
        shifted[i, j, :3, 3] += shift
        to_camera = later.to_cameras[0] @ np.linalg.inv(shifted[i, j])
        scores[i, j] = later.score(earlier.patches[-1], to_camera, level=-1)
    is_maximum = scores >= cv2.dilate(scores, np.ones((3, 3)))
    is_maximum &= np.hypot(rows[:, None], columns) > JOINTS.turn_step
    places = np.argwhere(is_maximum & (scores > JOINTS.min_coarse_score)).tolist()
    places.sort(key=lambda place: -scores[place[0], place[1]])
    return [shifted[i, j] for i, j in places[: JOINTS.max_rivals]]


def _shift_steps(side: int) -> np.ndarray:
    """Return shifts along a side of a frame, px of its level."""
    extent = int(JOINTS.max_turn * side)
    return np.arange(-extent, extent + 1, JOINTS.turn_step, dtype=np.float64)


def _differ(first: Alignment, second: Alignment, earlier: PieceEnd, later: PieceEnd) -> bool:
    """Return whether two alignments show the points of the later piece at different places."""
    points = later.patches[0].points.mean(axis=1)
    places = []
    for alignment in (first, second):
        moved = transform_points(alignment.similarity, points)
        local = transform_points(np.linalg.inv(earlier.poses[0]), moved)
        places.append(local[:, :2] / np.maximum(local[:, 2:], 1e-3 * earlier.median_depth))
    distance = np.median(np.linalg.norm(places[0] - places[1], axis=1)) * earlier.camera.focal
    return bool(distance > JOINTS.min_rival_distance * max(earlier.shape))


def _agree(first: Alignment, second: Alignment) -> bool:
    """Return whether two alignments that share no patches agree.

    At a wrong local minimum, the patches of both pieces need not contradict each other, but each
    alone moves away from it.
    """
    turn, log_scale = _difference(first, second)
    return turn < JOINTS.max_turn_difference and log_scale < JOINTS.max_scale_difference


def _difference(first: Alignment, second: Alignment) -> tuple[float, float]:
    """Return the turn, rad, and the absolute logarithm of the scale, between two similarities."""
    difference = np.linalg.inv(first.similarity) @ second.similarity
    scale = sim3_scale(difference)
    turn = Rotation.from_matrix(difference[:3, :3] / scale).magnitude()
    return float(turn), float(abs(np.log(scale)))


def _starts(earlier: PieceEnd, later: PieceEnd, gap: int) -> Iterator[np.ndarray]:
    """Yield similarities from which an alignment may begin."""
    for motion in (
        np.eye(4),
        _extrapolate(earlier, gap),
        _scaled(np.linalg.inv(_extrapolate(later, gap)), earlier, later),
    ):
        yield start_similarity(motion, earlier, later)
    turn = np.eye(4)
    turn[:3, :3] = _find_turn(earlier, later)
    yield start_similarity(turn, earlier, later)


def _extrapolate(end: PieceEnd, gap: int) -> np.ndarray:
    """Return the motion of a camera over the gap, (4, 4), if it moves on as in its piece."""
    if len(end.poses) < 2:
        return np.eye(4)
    motion = np.linalg.inv(end.poses[1]) @ end.poses[0]
    frames = JOINTS.frame_steps[1]
    extrapolated = np.eye(4)
    rotation = Rotation.from_matrix(motion[:3, :3]).as_rotvec() * gap / frames
    extrapolated[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    extrapolated[:3, 3] = motion[:3, 3] * gap / frames
    return extrapolated


def _scaled(motion: np.ndarray, earlier: PieceEnd, later: PieceEnd) -> np.ndarray:
    """Return a motion in the unit of the later piece as one in the unit of the earlier piece."""
    scaled = motion.copy()
    scaled[:3, 3] *= earlier.median_depth / later.median_depth
    return scaled


def _find_turn(earlier: PieceEnd, later: PieceEnd) -> np.ndarray:
    """Return the rotation, (3, 3), under which the first later frame shows the patches best.

    It is the best of a grid of turns, by up to `JOINTS.max_turn` of the frame, at the coarsest
    level.
    """
    level = earlier.levels[0][-1]
    height, width = level.image.shape
    steps = [_shift_steps(width), _shift_steps(height)]
    angle = level.factor / earlier.camera.focal  # of a pixel of this level
    best_score, best_turn = -1.0, np.eye(3)
    for shift_x in steps[0]:
        for shift_y in steps[1]:
            turn = Rotation.from_rotvec([shift_y * angle, -shift_x * angle, 0.0]).as_matrix()
            motion = np.eye(4)
            motion[:3, :3] = turn
            to_camera = np.linalg.inv(earlier.poses[0] @ motion)[:3]
            score = later.score(earlier.patches[-1], to_camera, level=-1)
            if score > best_score:
                best_score, best_turn = score, turn
    return best_turn


def _are_consecutive(earlier: Piece, later: Piece) -> bool:
    gap = min(later.poses) - max(earlier.poses)
    return not (earlier.only_turns or later.only_turns) and 0 < gap <= JOINTS.max_gap


def _piece_end(
    piece: Piece,
    observations: Sequence[Observations],
    camera: Camera,
    grey: Callable[[int], np.ndarray],
    *,
    is_last: bool,  # whether it is the end of the piece, rather than its begin
) -> PieceEnd | None:
    """Return an end of a piece; None if its frames show too few points."""
    frames = sorted(piece.poses, reverse=is_last)
    frames = [frames[step] for step in JOINTS.frame_steps if step < len(frames)]
    points, used_tracks = [], np.zeros(0, np.int64)
    for frame in frames:
        new = observations[frame].select(~np.isin(observations[frame].tracks, used_tracks))
        indices, world = points_of_tracks(new, piece.points)
        used_tracks = np.concatenate([used_tracks, new.tracks[indices]])
        depths = (world - piece.poses[frame][:3, 3]) @ piece.poses[frame][:3, 2]
        chosen = _choose_points(new.points[indices], depths)
        points.append((new.points[indices][chosen], depths[chosen]))
    if sum(len(depths) for _, depths in points) < JOINTS.min_points:
        return None
    return PieceEnd(
        images=[grey(frame) for frame in frames],
        poses=np.array([piece.poses[frame] for frame in frames]),
        points=points,
        camera=camera,
    )


def _choose_points(places: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Return the numbers of at most `JOINTS.max_points` points in front of the camera, spread."""
    numbers = np.flatnonzero(depths > 0)
    step = max(1, -(-len(numbers) // JOINTS.max_points))
    order = np.lexsort((places[numbers, 1], places[numbers, 0]))
    return np.sort(numbers[order][::step])


def _merge(earlier: Piece, later: Piece, similarity: np.ndarray) -> Piece:
    """Return both pieces in the coordinates of the earlier one."""
    moved = {frame: transform_pose(similarity, pose) for frame, pose in later.poses.items()}
    points = TrackPoints.from_mapping(later.points)
    moved_points = TrackPoints(
        tracks=points.tracks, positions=transform_points(similarity, points.positions)
    )
    return replace(
        earlier,
        poses={**earlier.poses, **moved},
        views=(*earlier.views, *later.views),
        joints=(*earlier.joints, min(later.poses), *later.joints),
        rival=earlier.rival or later.rival,
        points=moved_points | TrackPoints.from_mapping(earlier.points),
    )
