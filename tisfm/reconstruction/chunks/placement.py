"""Placement of chunks: similarities from their pieces to worlds, and a place for every frame.

A world is a set of pieces in common coordinates. The joined result has one piece for each world.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from tisfm.errors import InputError
from tisfm.reconstruction.chunks.chunk import Span
from tisfm.reconstruction.chunks.overlaps import ChunkOverlap, overlap_sim3
from tisfm.reconstruction.geometry.sim3 import sim3_scale, transform_pose
from tisfm.reconstruction.geometry.sim3_graph import chain_sim3
from tisfm.reconstruction.result.reconstruction import Reconstruction


@dataclass(frozen=True, kw_only=True)
class ChunkResult:
    """The result of a chunk."""

    result: Reconstruction
    frames: dict[int, int]  # by the number of a frame in the source: its number in the result

    @classmethod
    def from_result(cls, result: Reconstruction, span: Span, frames: range) -> "ChunkResult":
        """Return the result of a chunk, for the span of the chunk in the selected frames.

        Raises ValueError if the result has another number of frames.
        """
        skipped = {index for index, _ in result.skipped}
        indices = [index for index in frames[span.slice_in(frames)] if index not in skipped]
        if len(indices) != len(result):
            raise InputError(
                f"{result.folder} has {len(result)} frames, expected {len(indices)}: the source "
                "has changed meanwhile"
            )
        return cls(result=result, frames={index: number for number, index in enumerate(indices)})

    @cached_property
    def _sources(self) -> dict[int, int]:
        return {number: index for index, number in self.frames.items()}

    def source(self, number: int) -> int:
        """Return the number in the source of a frame of the result."""
        return self._sources[number]

    def piece(self, index: int) -> int:
        """Return the piece of a frame; −1 for none."""
        return int(self.result.piece[self.frames[index]]) if index in self.frames else -1

    def knowledge(self, index: int) -> int:
        """Return 2 for a frame with a pose, 1 for one with an orientation only, 0 for others."""
        piece = self.piece(index)
        if piece < 0:
            return 0
        return 2 if self.result.has_position[self.frames[index]] else 1


@dataclass(frozen=True, kw_only=True)
class ChunkPlacement:
    """The source of a frame of the joined result: a frame of a chunk; and its pose and scale."""

    part: int  # number of the chunk
    number: int  # number of the frame in the chunk
    piece: int  # number of the piece in the joined result; −1 for none
    pose: np.ndarray  # (4, 4) float64: camera to world; NaN for a frame without a pose
    scale: float  # factor for the depth of the chunk


def place_chunks(
    parts: Sequence[ChunkResult],  # results in order; neighbours share frames
    *,
    has_given_poses: bool,  # whether the user gave poses: then all results have one world and unit
) -> list[ChunkPlacement]:
    """Return the placement of every frame of the joined result, in order."""
    chunk_numbers = _chunk_of_frames(parts)
    nodes = [(k, piece) for k, part in enumerate(parts) for piece in range(len(part.result.unit))]
    if has_given_poses:
        worlds = [{node: np.eye(4) for node in range(len(nodes))}]
    else:
        worlds = _find_worlds(parts, nodes)
    world_of_node = {nodes[node]: n for n, world in enumerate(worlds) for node in world}
    similarities = {
        nodes[node]: similarity_of_node
        for world in worlds
        for node, similarity_of_node in world.items()
    }
    piece_numbers: dict[int, int] = {}
    bases: dict[int, tuple[np.ndarray, float]] = {}  # by world: its first pose, and its unit
    placements = []
    for index, chunk_number in chunk_numbers.items():
        part = parts[chunk_number]
        node, number = (chunk_number, part.piece(index)), part.frames[index]
        if node[1] < 0:
            no_pose = np.full((4, 4), np.nan)
            placements.append(
                ChunkPlacement(part=chunk_number, number=number, piece=-1, pose=no_pose, scale=1.0)
            )
            continue
        world = world_of_node[node]
        pose = transform_pose(similarities[node], part.result.poses[number])
        if world not in piece_numbers:
            piece_numbers[world] = len(piece_numbers)
            unit = _unit_of_world(parts, chunk_numbers, similarities, world_of_node, world)
            # For the first frame of all, the base is an exact identity.
            is_identity = np.allclose(pose, np.eye(4), atol=1e-12)
            bases[world] = (np.eye(4) if is_identity or has_given_poses else pose), unit
        base, unit = bases[world]
        pose = np.linalg.solve(base, pose)
        pose[:3, 3] /= unit
        scale = sim3_scale(similarities[node]) / unit
        placements.append(
            ChunkPlacement(
                part=chunk_number, number=number, piece=piece_numbers[world], pose=pose, scale=scale
            )
        )
    return placements


def _chunk_of_frames(parts: Sequence[ChunkResult]) -> dict[int, int]:
    """Return the number of the chunk of each frame, by the frame's number in the source."""
    chunk_numbers: dict[int, int] = {}
    first_frames = [_first_frame_of_later(before, after) for before, after in pairwise(parts)]
    for k, part in enumerate(parts):
        for index in part.frames:
            if k == 0 or index >= first_frames[k - 1]:
                chunk_numbers[index] = k
    for k, (before, after) in enumerate(pairwise(parts)):
        for index in before.frames.keys() & after.frames.keys():
            # Prefer the chunk in which the frame has a pose, or else an orientation.
            for chunk, other in ((k, k + 1), (k + 1, k)):
                if parts[chunk].knowledge(index) < parts[other].knowledge(index):
                    chunk_numbers[index] = other
    return dict(sorted(chunk_numbers.items()))


def _first_frame_of_later(before: ChunkResult, after: ChunkResult) -> int:
    """Return the first frame that the later of two chunks gives to the joined result.

    This is the keyframe of the later chunk that is nearest to the middle of the shared frames.
    Without a keyframe in the middle half, this is the middle frame.
    """
    shared = sorted(before.frames.keys() & after.frames.keys())
    if not shared:
        return min(after.frames)
    middle, quarter = len(shared) // 2, len(shared) // 4
    keyframes = [
        k
        for k in range(quarter, len(shared) - quarter)
        if after.frames[shared[k]] in after.result.keyframes
    ]
    return shared[min(keyframes, key=lambda k: (abs(k - middle), k), default=middle)]


def _find_worlds(
    parts: Sequence[ChunkResult], nodes: Sequence[tuple[int, int]]
) -> list[dict[int, np.ndarray]]:
    """Return the similarities from pieces to their world, by the indices of `nodes`, per world.

    A node is a chunk and a piece of the chunk.
    """
    node_numbers = {node: n for n, node in enumerate(nodes)}
    overlaps = []
    for k, (before, after) in enumerate(pairwise(parts)):
        shared_frames: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for index in sorted(before.frames.keys() & after.frames.keys()):
            pair = before.piece(index), after.piece(index)
            if min(pair) >= 0:
                shared_frames.setdefault(pair, []).append(
                    (before.frames[index], after.frames[index])
                )
        for (first, second), shared in sorted(shared_frames.items()):
            similarity = overlap_sim3(before.result, after.result, shared)
            if similarity is not None:
                overlaps.append(
                    ChunkOverlap(
                        first=node_numbers[k, first],
                        second=node_numbers[k + 1, second],
                        similarity=similarity,
                        frames=len(shared),
                    )
                )
    overlaps.sort(key=lambda overlap: -overlap.frames)
    return chain_sim3(len(nodes), overlaps)


def _unit_of_world(
    parts: Sequence[ChunkResult],
    chunk_numbers: dict[int, int],  # from `_chunk_of_frames`
    # by node: (4, 4) array, from the coordinates of its piece to its world
    similarities: dict[tuple[int, int], np.ndarray],
    world_of_node: dict[tuple[int, int], int],
    world: int,
) -> float:
    """Return the scale of the piece with the first keyframe of a world.

    The unit of this piece becomes the unit of the world.
    """
    world_frames = [
        (chunk_number, index)
        for index, chunk_number in chunk_numbers.items()
        if world_of_node.get((chunk_number, parts[chunk_number].piece(index))) == world
    ]
    first = next(
        (
            pair
            for pair in world_frames
            if parts[pair[0]].frames[pair[1]] in parts[pair[0]].result.keyframes
        ),
        world_frames[0],
    )
    return sim3_scale(similarities[first[0], parts[first[0]].piece(first[1])])
