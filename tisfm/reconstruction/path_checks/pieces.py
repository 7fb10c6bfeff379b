"""All checks of a piece of a path."""

from collections.abc import Callable, Mapping, Sequence

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
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.tracks.tracker import Observations


def check_piece(
    poses: Mapping[int, np.ndarray],  # by frame, in order: (4, 4), camera to world
    keyframes: Sequence[int],
    observations: Sequence[Observations],  # by frame
    grey: Callable[[int], np.ndarray],  # frame → (H, W) grey levels
    is_static: Callable[[int], np.ndarray],  # frame → (H, W) bool
    inverse_depth: Callable[[int], np.ndarray | None],  # frame → (H, W)
    camera: Camera,  # pinhole camera of the frames
) -> PathCheck:
    """Check a piece of a path by pairs of its frames."""
    frames = list(poses)
    pairs = []
    for first in choose_first_frames(frames, keyframes):
        second = choose_second_frame(first, frames, observations, max(grey(first).shape))
        if second is None:
            continue
        motion = np.linalg.inv(poses[second]) @ poses[first]
        pair = find_dense_pair(
            (first, grey(first)), (second, grey(second)), motion, camera, is_static(first)
        )
        if pair is not None:
            depth = inverse_depth(first)
            if depth is not None:
                depth = cv2.resize(depth, pair.shape[::-1], interpolation=cv2.INTER_NEAREST)
            pairs.append(weigh_pair(pair, depth))
    compared_frames = spread_evenly(frames, PATH_CHECKS.max_fixed_frames)
    images = [grey(frame) for frame in compared_frames]
    scale = flow_scale(shrink_for_flow(images[0]), images[0])
    rotations = [poses[frame][:3, :3] for frame in compared_frames]
    return PathCheck(
        pairs=tuple(pairs),
        fixed_share=measure_fixed_texture(images).share,
        infinity_motion=find_infinity_motion(rotations, camera) * scale,
    )


def choose_first_frames(frames: Sequence[int], keyframes: Sequence[int]) -> list[int]:
    """Return the first frames of the pairs: keyframes, or frames if there are few keyframes."""
    candidates = [frame for frame in keyframes if frame in set(frames)]
    if len(candidates) < PATH_CHECKS.min_keyframes:
        candidates = sorted({*candidates, *spread_evenly(frames, PATH_CHECKS.max_pairs)})
    return spread_evenly(candidates, PATH_CHECKS.max_pairs)


def choose_second_frame(
    first: int, frames: Sequence[int], observations: Sequence[Observations], longer_side: int
) -> int | None:
    """Return the frame whose tracks have moved by about the wanted share of the longer side."""
    best, lowest_cost = None, np.inf
    for other in frames:
        if not 0 < abs(other - first) <= PATH_CHECKS.max_pair_steps:
            continue
        pixels = track_motion(observations[first], observations[other])
        if pixels is None:
            continue
        motion = max(pixels / longer_side, PATH_CHECKS.min_pair_motion)
        cost = abs(np.log(motion / PATH_CHECKS.pair_motion))
        if other < first:
            cost += PATH_CHECKS.backward_cost
        if cost < lowest_cost:
            best, lowest_cost = other, cost
    return best


def track_motion(first: Observations, second: Observations) -> float | None:
    """Return the median motion of the tracks of two frames, px; None for too few."""
    _, rows, others = np.intersect1d(first.tracks, second.tracks, return_indices=True)
    if len(rows) < PATH_CHECKS.min_pair_tracks:
        return None
    return float(np.median(np.hypot(*(second.points[others] - first.points[rows]).T)))
