"""All checks of a piece of a path."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.image_motion import (
    chain_flows,
    flow_scale,
    shrink_for_flow,
)
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

# Number of a frame → (h, w, 2) float32 motion from the previous frame, px of the shrunk frames, or
# None if it was not kept.
KeptFlow = Callable[[int], np.ndarray | None]


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
    kept_flow: KeptFlow = lambda _: None,
    views: Sequence[int] = (),  # frames that tracks placed in their part of the piece
    joints: Sequence[int] = (),  # first frames of parts that were joined to the part before them
) -> PathCheck:
    """Check a piece of a path by pairs of its frames; each pair is checked once.

    The pair of frames on both sides of a joint is a part of the check of its own: one wrong joint
    would hide among right pairs. One pair shows no zoom, as nothing tells its error.
    """
    checked: set[frozenset[int]] = set()
    pairs = []
    for first in choose_first_frames(list(poses), keyframes):
        second = choose_second_frame(first, list(poses), observations, max(grey(first).shape))
        if second is None or frozenset((first, second)) in checked:
            continue
        checked.add(frozenset((first, second)))
        pair = check_pair(first, second, poses, grey, is_static, camera, inverse_depth, kept_flow)
        if pair is not None:
            pairs.append(pair)
    check = check_with_pairs(pairs, poses, grey, camera)
    # Frames between two parts may have poses from either part: the last view is in the earlier one.
    beside = [(max(view for view in views if view < joint), joint) for joint in joints]
    across = (
        check_pair(*sides, poses, grey, is_static, camera, kept_flow=kept_flow) for sides in beside
    )
    parts = [
        PathCheck(pairs=(replace(pair, zoom=0.0),), fixed_share=0.0, infinity_motion=0.0)
        for pair in across
        if pair is not None
    ]
    return PathCheck.joined([check, *parts])


def check_pair(
    first: int,
    second: int,
    poses: Mapping[int, np.ndarray],  # poses and the arguments after it: as for a piece
    grey: Callable[[int], np.ndarray],
    is_static: Callable[[int], np.ndarray],
    camera: Camera,
    inverse_depth: Callable[[int], np.ndarray | None] = lambda _: None,
    kept_flow: KeptFlow = lambda _: None,
) -> PairEvidence | None:
    """Return the evidence of a pair of frames; None if too few of its pixels are textured.

    If the image motion between the frames was kept, the pair goes forward in time.
    """
    flow = chain_kept_flow(kept_flow, *sorted((first, second)))
    if flow is not None:
        first, second = sorted((first, second))
    motion = np.linalg.inv(poses[second]) @ poses[first]
    pair = find_dense_pair(
        (first, grey(first)), (second, grey(second)), motion, camera, is_static(first), flow
    )
    if pair is None:
        return None
    depth = inverse_depth(first)
    if depth is not None:
        depth = cv2.resize(depth, pair.shape[::-1], interpolation=cv2.INTER_NEAREST)
    return weigh_pair(pair, depth)


def chain_kept_flow(kept_flow: KeptFlow, first: int, last: int) -> np.ndarray | None:
    """Return the kept motion from a frame to a later one; None if a part of it was not kept."""
    flows = []
    for number in range(first + 1, last + 1):
        flow = kept_flow(number)
        if flow is None:
            return None
        flows.append(flow)
    return chain_flows(flows)


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
    count = round(len(frames) / PATH_CHECKS.frames_per_pair)
    count = min(max(count, PATH_CHECKS.min_pairs), PATH_CHECKS.max_pairs)
    candidates = [frame for frame in keyframes if frame in known]
    if len(candidates) < PATH_CHECKS.min_keyframes:
        candidates = sorted({*candidates, *spread_evenly(frames, count)})
    return spread_evenly(candidates, count)


def choose_second_frame(
    first: int, frames: Sequence[int], observations: FrameObservations, longer_side: int
) -> int | None:
    """Return the frame whose tracks have moved by about the wanted share of the longer side.

    Frames that share few tracks with the first one, compared with the nearest frame, are too far.
    """
    motions = [
        (other, *measure_track_motion(observations[first], observations[other]))
        for other in frames
        if 0 < abs(other - first) <= PATH_CHECKS.max_pair_steps
    ]
    most_tracks = max((count for _, _, count in motions), default=0)
    min_tracks = max(PATH_CHECKS.min_pair_tracks, PATH_CHECKS.min_kept_tracks * most_tracks)
    best, lowest_cost = None, np.inf
    for other, pixels, count in motions:
        if count < min_tracks:
            continue
        motion = max(pixels / longer_side, PATH_CHECKS.min_pair_motion)
        cost = abs(np.log(motion / PATH_CHECKS.pair_motion))
        if other < first:
            cost += PATH_CHECKS.backward_cost
        if cost < lowest_cost:
            best, lowest_cost = other, cost
    return best


def measure_track_motion(first: Observations, second: Observations) -> tuple[float, int]:
    """Return the median motion of the tracks of two frames, px, and their number."""
    indices, other_indices = first.common_tracks(second)
    if not len(indices):
        return 0.0, 0
    motion = second.points[other_indices] - first.points[indices]
    return float(np.median(np.hypot(*motion.T))), len(indices)
