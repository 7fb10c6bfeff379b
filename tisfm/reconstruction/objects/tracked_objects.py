"""Tracked moving objects: their state, their similarity, and the union of parts of one object."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from tisfm.reconstruction.objects.settings import OBJECTS

# Largest label: in labels of the user, 255 marks ignored pixels.
MAX_OBJECTS = 254


@dataclass(kw_only=True)
class TrackedObject:
    """The state of a tracked object."""

    id: int
    last_frame: int  # the last frame in which it was labelled
    mask: np.ndarray  # (H, W) bool: its mask in that frame, with its occluded parts
    velocity: np.ndarray  # (2,) float64: its mean motion in that frame, px/frame
    histogram: np.ndarray  # (B,) float64: its grey-level histogram; the sum is 1
    core_frames: int = 0  # number of frames in which its region has a core (`find_moving_regions`)
    pixel_count: int = 0  # its labelled pixels in all frames
    # dict of int to (2,) float64: by frame: its mean motion minus the motion of its surroundings,
    # px/frame
    motions: dict[int, np.ndarray] = field(default_factory=dict)
    # dict of int to (3,) float64: by frame: its centre, (x, y), and its size, the square root of
    # its area, px
    positions: dict[int, np.ndarray] = field(default_factory=dict)
    # by frame: mean evidence of its pixels in this frame alone, weighted
    evidence: dict[int, float] = field(default_factory=dict)
    # median of this evidence in its first frames; None before it has enough frames with a core
    early_evidence: float | None = None

    def add_core(self, has_core: bool) -> None:
        """Count a frame whose region has a core, or has none."""
        self.core_frames += has_core
        if has_core and self.core_frames == OBJECTS.min_object_frames:
            self.early_evidence = float(np.median(list(self.evidence.values())))

    def is_clear(self, pixels: int) -> bool:
        """Return whether it moved clearly in its first frames, and at an area like this one."""
        limit = OBJECTS.min_clear_evidence
        if self.early_evidence is None or self.early_evidence < limit:
            return False
        sizes = [self.positions[k][2] for k, evidence in self.evidence.items() if evidence >= limit]
        return bool(sizes) and pixels <= OBJECTS.max_growth * max(sizes) ** 2


def mask_position(mask: np.ndarray) -> np.ndarray:
    """Return the centre, (x, y), of a mask, and its size, the square root of its area, px, (3,)."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean(), mask.sum() ** 0.5])


def most_similar_object(
    objects: Iterable[TrackedObject],
    frame: int,
    position: np.ndarray,  # (3,) float64: centre and size of a region, as in `mask_position`
    histogram: np.ndarray,  # (B,) float64: grey-level histogram of the region
) -> int:
    """Return the id of the occluded object that reappears in a region of a frame; 0 for none."""
    max_similarity, best_id = 0.0, 0
    for obj in objects:
        interval = frame - obj.last_frame
        if not 0 < interval <= OBJECTS.max_occlusion + 1 or not obj.mask.any():
            continue
        last_position = mask_position(obj.mask)
        expected = last_position[:2] + interval * obj.velocity
        limit = max(position[2], last_position[2]) * (1 + OBJECTS.distance_growth * interval)
        distance = float(np.linalg.norm(position[:2] - expected) / limit)
        overlap = float(np.sqrt(histogram * obj.histogram).sum())
        if (
            distance >= OBJECTS.max_reappearance_distance
            or overlap <= OBJECTS.min_histogram_overlap
        ):
            continue
        if overlap / (1 + distance) > max_similarity:
            max_similarity, best_id = overlap / (1 + distance), obj.id
    return best_id


def final_labels(
    objects: Mapping[int, TrackedObject],  # by id
    # number of frames in which two objects touch, by their ids in increasing order
    touching_frames: Mapping[tuple[int, int], int],
    frame_count: int,  # frames of the sequence
) -> np.ndarray:
    """Return the final label of each object, (K,) uint8, by its id; 0 for a rejected object.

    Parts of one object get one label. An object keeps its label after an occlusion. An object is
    rejected if it has few frames, or moves clearly in few of them.
    """
    count = 1 + max(objects, default=0)
    root = np.arange(count)  # by id: the object that this object is a part of
    by_size = sorted(objects, key=lambda k: objects[k].pixel_count)
    for index, smaller in enumerate(by_size):
        larger_objects = [
            k
            for k in by_size[index + 1 :]
            if _is_part_of(objects[smaller], objects[k], touching_frames.get(_ids(smaller, k), 0))
        ]
        if larger_objects:
            root[smaller] = larger_objects[-1]  # the largest object
    for smaller in reversed(by_size):  # larger objects first
        root[smaller] = root[root[smaller]]
    for later in sorted(objects):  # objects that reappear
        if root[later] == later and (earlier := _earlier_object(objects, later, root)):
            root[root == later] = root[earlier]
    table, number, limit = np.zeros(count, np.uint8), 0, OBJECTS.min_kept_evidence
    for obj in sorted(objects):
        if root[obj] != obj:
            continue
        members = np.flatnonzero(root == obj)
        frames = {frame for k in members for frame in objects[int(k)].motions}
        min_frames = min(OBJECTS.min_object_frames, frame_count)
        core_frames = sum(objects[int(k)].core_frames for k in members)
        is_clear = [
            any(objects[int(k)].evidence.get(frame, -1.0) >= limit for k in members)
            for frame in frames
        ]
        moves_clearly = bool(is_clear) and np.mean(is_clear) >= OBJECTS.min_clear_share
        is_long = len(frames) >= min_frames and core_frames >= min_frames - 1
        if is_long and moves_clearly and number < MAX_OBJECTS:
            number += 1
            table[members] = number
    return table


def _ids(first: int, second: int) -> tuple[int, int]:
    return min(first, second), max(first, second)


def _earlier_object(objects: Mapping[int, TrackedObject], later: int, root: np.ndarray) -> int:
    """Return the id of an earlier, occluded object that looks like a later object; 0 for none."""
    obj = objects[later]
    frames = [f for k in np.flatnonzero(root == later) for f in objects[int(k)].motions]
    first = min(frames, default=-1)
    if first not in obj.positions:  # as when the refined boundary left no pixel of the object
        return 0
    return most_similar_object(objects.values(), first, obj.positions[first], obj.histogram)


def _is_part_of(smaller: TrackedObject, larger: TrackedObject, touching_frames: int) -> bool:
    """Return whether an object is a part of a larger object: they touch, and move similarly."""
    frames = sorted(smaller.motions.keys() & larger.motions.keys())
    if touching_frames < max(1, OBJECTS.min_similar_touching * len(smaller.motions)) or not frames:
        return False
    pair = smaller, larger
    motions = np.array([[obj.motions[f] for f in frames] for obj in pair])
    speed = np.median(np.linalg.norm(motions, axis=2).max(axis=0))
    distance = np.median(np.linalg.norm(motions[0] - motions[1], axis=1))
    difference = float(distance / max(speed, 1e-9))  # as a share of the faster motion
    if (
        touching_frames >= OBJECTS.min_touching * len(smaller.motions)
        and difference < OBJECTS.max_same_motion_difference
    ):
        return True
    if touching_frames < OBJECTS.min_common_touching * len(frames):
        return False
    size = max(np.median([position[2] for position in obj.positions.values()]) for obj in pair)
    relative = motions[0] - motions[1]
    drift = np.linalg.norm(np.cumsum(relative, axis=0), axis=1).max()
    mean_speed = np.linalg.norm(motions.mean(axis=1), axis=1).max()
    stays = (
        len(frames) >= OBJECTS.min_common_frames
        and drift <= OBJECTS.max_drift * size
        and np.linalg.norm(relative.mean(axis=0)) <= OBJECTS.max_same_motion_difference * mean_speed
    )
    return bool(stays or difference < OBJECTS.max_similar_motion_difference)
