"""All checks of a piece of a path."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.image_motion import flow_scale, shrink_for_flow
from tisfm.reconstruction.path_checks.dense_pairs import find_dense_pair
from tisfm.reconstruction.path_checks.evidence import weigh_pair
from tisfm.reconstruction.path_checks.fixed_texture import (
    find_infinity_motion,
    measure_fixed_texture,
    spread_evenly,
)
from tisfm.reconstruction.path_checks.settings import PATH_CHECKS
from tisfm.reconstruction.result.path_check import PairEvidence, PathCheck
from tisfm.reconstruction.tracks.tracker import Observations


class FrameObservations(Protocol):
    """Tracks by frame."""

    def __getitem__(self, frame: int, /) -> Observations: ...


def check_piece(
    poses: Mapping[int, np.ndarray],  # by frame, in order: (4, 4), camera to world
    keyframes: Sequence[int],
    observations: FrameObservations,  # by frame
    grey: Callable[[int], np.ndarray],  # frame → (H, W) grey levels
    is_static: Callable[[int], np.ndarray],  # frame → (H, W) bool
    inverse_depth: Callable[[int], np.ndarray | None],  # frame → (H, W)
    camera: Camera,  # pinhole camera of the frames
) -> PathCheck:
    """Check a piece of a path by pairs of its frames."""
    pairs = []
    for first in choose_first_frames(list(poses), keyframes):
        depth = partial(inverse_depth, first)
        pair = check_pair(first, poses, observations, grey, is_static, camera, depth)
        if pair is not None:
            pairs.append(pair)
    return check_with_pairs(pairs, poses, grey, camera)


def check_pair(
    first: int,
    poses: Mapping[int, np.ndarray],  # poses, observations, grey, is_static, camera: as for a piece
    observations: FrameObservations,
    grey: Callable[[int], np.ndarray],
    is_static: Callable[[int], np.ndarray],
    camera: Camera,
    inverse_depth: Callable[[], np.ndarray | None] = lambda: None,  # (H, W), of the first frame
) -> PairEvidence | None:
    """Return the evidence of a frame and another one; None if no other frame is suitable."""
    second = choose_second_frame(first, list(poses), observations, max(grey(first).shape))
    if second is None:
        return None
    motion = np.linalg.inv(poses[second]) @ poses[first]
    pair = find_dense_pair(
        (first, grey(first)), (second, grey(second)), motion, camera, is_static(first)
    )
    if pair is None:
        return None
    depth = inverse_depth()
    if depth is not None:
        depth = cv2.resize(depth, pair.shape[::-1], interpolation=cv2.INTER_NEAREST)
    return weigh_pair(pair, depth)


def check_with_pairs(
    pairs: Sequence[PairEvidence],
    poses: Mapping[int, np.ndarray],  # by frame, in order: (4, 4), camera to world
    grey: Callable[[int], np.ndarray],  # frame → (H, W) grey levels
    camera: Camera,
) -> PathCheck:
    """Return the check of pairs, and of the texture that is fixed on the sensor in the frames."""
    frames = spread_evenly(list(poses), PATH_CHECKS.max_fixed_frames)
    images = [grey(frame) for frame in frames]
    scale = flow_scale(shrink_for_flow(images[0]), images[0])
    rotations = [poses[frame][:3, :3] for frame in frames]
    return PathCheck(
        pairs=tuple(pairs),
        fixed_share=measure_fixed_texture(images).share,
        infinity_motion=find_infinity_motion(rotations, camera) * scale,
    )


def choose_first_frames(frames: Sequence[int], keyframes: Sequence[int]) -> list[int]:
    """Return the first frames of the pairs: keyframes, or frames if there are few keyframes."""
    known = set(frames)
    candidates = [frame for frame in keyframes if frame in known]
    if len(candidates) < PATH_CHECKS.min_keyframes:
        candidates = sorted({*candidates, *spread_evenly(frames, PATH_CHECKS.max_pairs)})
    return spread_evenly(candidates, PATH_CHECKS.max_pairs)


def choose_second_frame(
    first: int, frames: Sequence[int], observations: FrameObservations, longer_side: int
) -> int | None:
    """Return the frame whose tracks have moved by about the wanted share of the longer side."""
    best, lowest_cost = None, np.inf
    for other in frames:
        if not 0 < abs(other - first) <= PATH_CHECKS.max_pair_steps:
            continue
        pixels = measure_track_motion(observations[first], observations[other])
        if pixels is None:
            continue
        motion = max(pixels / longer_side, PATH_CHECKS.min_pair_motion)
        cost = abs(np.log(motion / PATH_CHECKS.pair_motion))
        if other < first:
            cost += PATH_CHECKS.backward_cost
        if cost < lowest_cost:
            best, lowest_cost = other, cost
    return best


def measure_track_motion(first: Observations, second: Observations) -> float | None:
    """Return the median motion of the tracks of two frames, px; None for too few."""
    _, rows, others = np.intersect1d(first.tracks, second.tracks, return_indices=True)
    if len(rows) < PATH_CHECKS.min_pair_tracks:
        return None
    return float(np.median(np.hypot(*(second.points[others] - first.points[rows]).T)))
