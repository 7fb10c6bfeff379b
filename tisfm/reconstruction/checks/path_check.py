"""All checks of a piece of a path."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.checks.dense_pair import dense_pair
from tisfm.reconstruction.checks.fixed_pixels import fixed_pixels, infinity_motion
from tisfm.reconstruction.checks.pair_evidence import pair_evidence
from tisfm.reconstruction.checks.settings import CHECKS
from tisfm.reconstruction.frames.image_motion import flow_scale, shrink_for_flow
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
    for first in first_frames(frames, keyframes):
        second = second_frame(first, frames, observations, max(grey(first).shape))
        if second is None:
            continue
        motion = np.linalg.inv(poses[second]) @ poses[first]
        found = dense_pair(
            (first, grey(first)), (second, grey(second)), motion, camera, is_static(first)
        )
        if found is not None:
            pairs.append(pair_evidence(found, shrunk(inverse_depth(first), found.shape)))
    chosen = [frames[k] for k in spread(len(frames), CHECKS.max_fixed_frames)]
    compared = [grey(k) for k in chosen]
    _, fixed, moving = fixed_pixels(compared)
    share = fixed / max(fixed + moving, 1e-9)
    scale = flow_scale(shrink_for_flow(compared[0]), compared[0])
    motion_at_infinity = infinity_motion([poses[k][:3, :3] for k in chosen], camera) * scale
    return PathCheck(pairs=tuple(pairs), fixed_share=share, infinity_motion=motion_at_infinity)


def spread(count: int, limit: int) -> list[int]:
    """Return at most `limit` of `count` indices, evenly spread."""
    return [int(k) for k in np.unique(np.linspace(0, count - 1, min(count, limit)).astype(int))]


def first_frames(frames: Sequence[int], keyframes: Sequence[int]) -> list[int]:
    """Return the first frames of the pairs: keyframes, or frames if there are few keyframes."""
    candidates = [frame for frame in keyframes if frame in set(frames)]
    if len(candidates) < 3:
        candidates = sorted(
            {*candidates, *(frames[k] for k in spread(len(frames), CHECKS.max_pairs))}
        )
    return [candidates[k] for k in spread(len(candidates), CHECKS.max_pairs)]


def second_frame(
    first: int, frames: Sequence[int], observations: Sequence[Observations], side: int
) -> int | None:
    """Return the frame whose tracks have moved by about the wanted share of the longer side."""
    best, best_difference = None, np.inf
    for other in frames:
        steps = abs(other - first)
        if not 0 < steps <= CHECKS.max_pair_steps:
            continue
        moved = track_motion(observations[first], observations[other])
        if moved is None:
            continue
        difference = (
            abs(np.log(max(moved / side, 1e-5) / CHECKS.pair_motion)) + (other < first) * 0.5
        )
        if difference < best_difference:
            best, best_difference = other, difference
    return best


def track_motion(first: Observations, second: Observations) -> float | None:
    """Return the median motion of the tracks of two frames, px; None for too few."""
    _, rows, others = np.intersect1d(first.tracks, second.tracks, return_indices=True)
    if len(rows) < 20:
        return None
    return float(np.median(np.hypot(*(second.points[others] - first.points[rows]).T)))


def shrunk(image: np.ndarray | None, shape: tuple[int, int]) -> np.ndarray | None:
    """Return an image with another shape, at nearest pixels."""
    import cv2

    if image is None:
        return None
    return cv2.resize(image, shape[::-1], interpolation=cv2.INTER_NEAREST)
