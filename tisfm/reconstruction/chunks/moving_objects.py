"""Moving objects of a sequence, from the moving objects of its chunks.

An object of a chunk and one of the next chunk are the same if their labels cover the same pixels in
the frames that both chunks contain. Its axes in the joined result are those of one of its chunks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from tisfm.reconstruction.chunks.placement import ChunkPlacement, ChunkResult
from tisfm.reconstruction.chunks.settings import CHUNKING
from tisfm.reconstruction.geometry.sim3 import mean_pose
from tisfm.reconstruction.objects.tracked_objects import MAX_OBJECTS
from tisfm.reconstruction.result.folder import read_labels, write_labels
from tisfm.reconstruction.result.moving_object import MovingObject, labelled_objects

NO_AXES = "its axes in some chunks are unknown"
Ids = Sequence[dict[int, int]]
"""For each chunk: the id in the joined result of each id of the chunk."""


@dataclass(frozen=True, kw_only=True)
class _ObjectPoses:
    """The poses of an object in a chunk, in the unit of the joined result."""

    entry: MovingObject  # of the chunk
    # by the number of the frame in the source: (4, 4), from the axes of the object to the camera
    to_camera: dict[int, np.ndarray]
    scale: float  # length of the unit of the chunk, in the unit of the joined result; NaN: unknown


def write_joined_objects(
    folder: Path,  # output folder of the joined result
    parts: Sequence[ChunkResult],
    placements: Sequence[ChunkPlacement],  # placement of each frame of the joined result
) -> tuple[MovingObject, ...]:
    """Write the labels of all frames, and return the moving objects with their poses."""
    ids = join_ids(parts)
    shape = parts[0].result.shape
    for frame, placement in enumerate(placements):
        labels = parts[placement.part].result.labels(placement.number)
        table = np.zeros(256, np.uint8)
        for number, joined in ids[placement.part].items():
            table[number] = joined
        write_labels(folder, frame, table[labels])
    objects = labelled_objects(len(placements), lambda frame: read_labels(folder, frame, shape))
    # Frames in which the camera only turns have no positions, so objects have no poses there.
    pieces = [
        placement.piece
        for placement in placements
        if parts[placement.part].result.has_position[placement.number]
    ]
    largest = int(np.bincount(pieces).argmax()) if pieces else 0
    return tuple(_with_poses(obj, parts, placements, ids, largest) for obj in objects)


def join_ids(parts: Sequence[ChunkResult]) -> list[dict[int, int]]:
    """Return, for each chunk, the id in the joined result of each of its objects.

    Objects get ids in the order in which they appear. Objects after the number `MAX_OBJECTS` are
    left out, as labels have no value for them.
    """
    ids = [{obj.id: k for k, obj in enumerate(parts[0].result.objects, 1)}]
    count = len(ids[0])
    for before, after in pairwise(parts):
        matches = _match_objects(before, after)
        joined: dict[int, int] = {}
        for obj in after.result.objects:
            earlier = ids[-1].get(matches.get(obj.id, 0))
            if earlier is None:
                count += 1
            if earlier is not None or count <= MAX_OBJECTS:
                joined[obj.id] = count if earlier is None else earlier
        ids.append(joined)
    return ids


def _match_objects(before: ChunkResult, after: ChunkResult) -> dict[int, int]:
    """Return the id in a chunk of each object of the next chunk that is in both."""
    shared = sorted(before.frames.keys() & after.frames.keys())
    counts = np.zeros((256, 256), np.int64)
    for index in shared:
        pair = (part.result.labels(part.frames[index]) for part in (before, after))
        first, second = (labels.astype(np.intp).ravel() for labels in pair)
        counts += np.bincount(256 * first + second, minlength=256 * 256).reshape(256, 256)
    # A chunk may miss a part of an object at its ends: the smaller of two labels has to overlap.
    smaller = np.minimum(counts.sum(axis=1)[:, None], counts.sum(axis=0)[None])
    overlap = (counts / np.maximum(smaller, 1))[1:, 1:]
    firsts, seconds = linear_sum_assignment(overlap, maximize=True)
    return {
        int(second) + 1: int(first) + 1
        for first, second in zip(firsts, seconds, strict=True)
        if overlap[first, second] >= CHUNKING.min_object_overlap
    }


def _with_poses(
    obj: MovingObject,  # of the joined result, without poses
    parts: Sequence[ChunkResult],
    placements: Sequence[ChunkPlacement],
    ids: Ids,
    largest: int,  # the largest piece of the joined result
) -> MovingObject:
    """Return an object with its poses in the largest piece, its extent and its message.

    The chunk with most poses of the object gives the axes, the extent, the source of the scale and
    the message. Without poses, the chunk with most of its frames gives them.
    """
    chunks = {
        number: _object_poses(entry, number, part, placements, largest)
        for number, part in enumerate(parts)
        for entry in part.result.objects
        if ids[number].get(entry.id) == obj.id
    }
    main = max(chunks, key=lambda k: (len(chunks[k].to_camera), len(chunks[k].entry.frames)))
    axes = _common_axes(chunks, main)
    poses = obj.poses.copy()
    for k, frame in enumerate(obj.frames):
        placement = placements[frame]
        known = chunks[placement.part].to_camera.get(parts[placement.part].source(placement.number))
        if known is not None and placement.piece == largest and placement.part in axes:
            poses[k] = placement.pose @ known @ axes[placement.part]
    entry = chunks[main].entry
    message = entry.message
    if any(item.to_camera and number not in axes for number, item in chunks.items()):
        message = f"{message}; {NO_AXES}" if message else NO_AXES
    return replace(
        obj,
        poses=poses,
        extent=entry.extent * chunks[main].scale,
        scale_from=entry.scale_from,
        message=message,
    )


def _object_poses(
    entry: MovingObject,
    chunk: int,
    part: ChunkResult,
    placements: Sequence[ChunkPlacement],
    largest: int,  # the largest piece of the joined result
) -> _ObjectPoses:
    """Return the poses of an object of a chunk, relative to the camera, in the joined unit.

    The object has no poses if the largest piece of the chunk is not in the largest piece of the
    joined result: the ratio of their units is unknown.
    """
    scale = next(
        (
            placement.scale
            for placement in placements
            if placement.part == chunk
            and placement.piece == largest
            and part.result.piece[placement.number] == part.result.largest_piece
        ),
        None,
    )
    to_camera = {}
    for frame, pose in zip(entry.frames, entry.poses, strict=True):
        if scale is not None and np.isfinite(pose).all():
            relative = np.linalg.solve(part.result.poses[frame], pose)
            relative[:3, 3] *= scale
            to_camera[part.source(frame)] = relative
    return _ObjectPoses(
        entry=entry, to_camera=to_camera, scale=float("nan") if scale is None else scale
    )


def _common_axes(chunks: dict[int, _ObjectPoses], main: int) -> dict[int, np.ndarray]:
    """Return, by chunk, the pose of the common axes of an object in its axes there, (4, 4).

    The main chunk defines them. Its neighbours before and after are known as long as each shares a
    frame with poses with the last one.
    """
    axes = {main: np.eye(4)}
    numbers = sorted(number for number in chunks if chunks[number].to_camera)
    for direction in (1, -1):
        known = main
        others = [number for number in numbers if (number - main) * direction > 0]
        for number in sorted(others, reverse=direction < 0):
            first, second = chunks[known].to_camera, chunks[number].to_camera
            shared = sorted(first.keys() & second.keys())
            if not shared:
                break
            steps = np.array([np.linalg.solve(second[k], first[k]) for k in shared])
            axes[number] = mean_pose(steps, np.ones(len(steps))) @ axes[known]
            known = number
    return axes
