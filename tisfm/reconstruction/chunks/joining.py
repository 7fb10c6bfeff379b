"""Joining of chunks: the similarities of their pieces to one world, and the folder of the whole."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from tisfm.camera_file import NAME as CAMERA
from tisfm.errors import InputError
from tisfm.formats.atomic import link_or_copy
from tisfm.formats.npz import NpzFile, write_npz
from tisfm.reconstruction.chunks.chunk import Span
from tisfm.reconstruction.chunks.overlaps import ChunkOverlap, overlap_sim3
from tisfm.reconstruction.geometry.sim3 import sim3_scale, transform_pose
from tisfm.reconstruction.geometry.sim3_graph import chain_sim3
from tisfm.reconstruction.result.folder import CACHE, PICTURES, depth_path, write_record
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.status import Status


@dataclass(frozen=True, kw_only=True)
class ChunkResult:
    """The result of a chunk."""

    result: Reconstruction
    frames: dict[int, int]  # number of each frame in the result, by its number in the source

    @classmethod
    def of(cls, result: Reconstruction, span: Span, frames: range) -> "ChunkResult":
        """Return the result of a chunk, for its span of the selected frames.

        Raises ValueError if the result has another number of frames.
        """
        skipped = {index for index, _ in result.skipped}
        kept = [index for index in frames[span.of(frames)] if index not in skipped]
        if len(kept) != len(result):
            raise InputError(
                f"{result.folder} has {len(result)} frames, expected {len(kept)}: the source has "
                "changed meanwhile"
            )
        return cls(result=result, frames={index: number for number, index in enumerate(kept)})

    def piece(self, index: int) -> int:
        """Return the piece of a frame; −1 for none."""
        return int(self.result.piece[self.frames[index]]) if index in self.frames else -1


@dataclass(frozen=True, kw_only=True)
class ChunkPlacement:
    """The chunk that a frame of the whole is taken from, and the frame's pose and scale."""

    # part, number: number of the chunk, and number of the frame in the chunk
    part: int
    number: int
    piece: int  # number of the piece in the whole; −1 for none
    pose: np.ndarray  # (4, 4) float64: camera to world; NaN for a frame without a pose
    scale: float  # factor for the depth of the chunk


def place_chunks(
    parts: Sequence[ChunkResult],  # results in order; each shares frames with the next
    *,
    are_given: bool,  # Whether poses were given. All results then have one world and one unit.
) -> list[ChunkPlacement]:
    """Return the placement of every frame of the whole, in order."""
    owners = _chunk_of_frames(parts)
    nodes = [(k, piece) for k, part in enumerate(parts) for piece in range(len(part.result.unit))]
    if are_given:
        worlds = [{node: np.eye(4) for node in range(len(nodes))}]
    else:
        worlds = _worlds(parts, nodes)
    of_node = {nodes[node]: n for n, world in enumerate(worlds) for node in world}
    similarity = {
        nodes[node]: similarity_of_node
        for world in worlds
        for node, similarity_of_node in world.items()
    }
    pieces: dict[int, int] = {}
    bases: dict[int, tuple[np.ndarray, float]] = {}  # the first pose of a piece, and its unit
    placements = []
    for index, owner in owners.items():
        part = parts[owner]
        node, number = (owner, part.piece(index)), part.frames[index]
        if node[1] < 0:
            no_pose = np.full((4, 4), np.nan)
            placements.append(
                ChunkPlacement(part=owner, number=number, piece=-1, pose=no_pose, scale=1.0)
            )
            continue
        world = of_node[node]
        pose = transform_pose(similarity[node], part.result.poses[number])
        if world not in pieces:
            pieces[world] = len(pieces)
            unit = _unit_of_world(parts, owners, similarity, of_node, world)
            is_identity = np.allclose(pose, np.eye(4), atol=1e-12)  # exactly the first frame
            bases[world] = (np.eye(4) if is_identity or are_given else pose), unit
        base, unit = bases[world]
        pose = np.linalg.solve(base, pose)
        pose[:3, 3] /= unit
        scale = sim3_scale(similarity[node]) / unit
        placements.append(
            ChunkPlacement(part=owner, number=number, piece=pieces[world], pose=pose, scale=scale)
        )
    return placements


def _chunk_of_frames(parts: Sequence[ChunkResult]) -> dict[int, int]:
    """Return the chunk of each frame, by its number in the source, in order."""
    owners: dict[int, int] = {}
    cuts = [_first_frame_of_later(before, after) for before, after in pairwise(parts)]
    for k, part in enumerate(parts):
        for index in part.frames:
            if k == 0 or index >= cuts[k - 1]:
                owners[index] = k
    for k, (before, after) in enumerate(pairwise(parts)):
        for index in before.frames.keys() & after.frames.keys():
            # Prefer the chunk in which the frame has a pose.
            for one, other in ((k, k + 1), (k + 1, k)):
                if parts[one].piece(index) < 0 <= parts[other].piece(index):
                    owners[index] = other
    return dict(sorted(owners.items()))


def _first_frame_of_later(before: ChunkResult, after: ChunkResult) -> int:
    """Return the first frame that is taken from the later of two chunks.

    It is the keyframe of the later chunk that is nearest to the middle of the shared frames.
    Without a keyframe in the middle half, it is the middle frame.
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


def _worlds(
    parts: Sequence[ChunkResult], nodes: Sequence[tuple[int, int]]
) -> list[dict[int, np.ndarray]]:
    """Return, for each world, the similarities of its pieces, by their node numbers."""
    number = {node: n for n, node in enumerate(nodes)}
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
                        first=number[k, first],
                        second=number[k + 1, second],
                        similarity=similarity,
                        frames=len(shared),
                    )
                )
    overlaps.sort(key=lambda overlap: -overlap.frames)
    return chain_sim3(len(nodes), overlaps)


def _unit_of_world(
    parts: Sequence[ChunkResult],
    owners: dict[int, int],
    similarity: dict[tuple[int, int], np.ndarray],
    of_node: dict[tuple[int, int], int],
    world: int,
) -> float:
    """Return the scale of the piece with the first keyframe of a world.

    The unit of this piece becomes the unit of the world.
    """
    own = [
        (owner, index)
        for index, owner in owners.items()
        if of_node.get((owner, parts[owner].piece(index))) == world
    ]
    first = next(
        (one for one in own if parts[one[0]].frames[one[1]] in parts[one[0]].result.keyframes),
        own[0],
    )
    return sim3_scale(similarity[first[0], parts[first[0]].piece(first[1])])


def write_whole(
    folder: Path,  # the folder of the whole, prepared for writing
    parts: Sequence[ChunkResult],
    places: Sequence[ChunkPlacement],  # placement of each frame of the whole
    *,
    camera: Reconstruction,  # the result whose camera all chunks share
    missing: Mapping[int, Status],  # frames without a given pose, and the reasons
    notes: Sequence[str],  # notes on how the source was read
) -> Reconstruction:
    """Write the whole sequence; the chunks stay unchanged."""
    first = parts[0].result
    for frame, place in enumerate(places):
        source = parts[place.part].result.folder
        link_or_copy(_picture(source, place.number), _picture(folder, frame))
        _copy_depth(depth_path(source, place.number), depth_path(folder, frame), place.scale)
    link_or_copy(camera.folder / CAMERA, folder / CAMERA)
    shutil.rmtree(folder / CACHE, ignore_errors=True)
    results = [parts[place.part].result for place in places]
    skipped = {index: reason for part in parts for index, reason in part.result.skipped}
    result = Reconstruction(
        poses=np.array([place.pose for place in places]),
        piece=np.array([place.piece for place in places], np.int32),
        unit=(1.0,) * (max(place.piece for place in places) + 1),
        status=tuple(_statuses(results, places, missing)),
        keyframes=tuple(
            frame
            for frame, (result_, place) in enumerate(zip(results, places, strict=True))
            if place.number in result_.keyframes
        ),
        camera=camera.camera,
        calibration=camera.calibration,
        settings=first.settings,
        names=tuple(
            result_.names[placement.number]
            for result_, placement in zip(results, places, strict=True)
        ),
        times=tuple(
            result_.times[placement.number]
            for result_, placement in zip(results, places, strict=True)
        ),
        skipped=tuple(sorted(skipped.items())),
        notes=tuple(notes),
        shape=first.shape,
        folder=folder,
        version=first.version,
    )
    write_record(folder, result)
    return result


def _statuses(
    results: Sequence[Reconstruction],
    places: Sequence[ChunkPlacement],
    missing: Mapping[int, Status],
) -> list[Status]:
    """Return the status of each frame; the first frame of a later piece has a note of it."""
    from tisfm.reconstruction.pipeline import add_piece_note, remove_piece_note

    statuses, known_pieces = [], {-1, 0}
    for frame, (one, place) in enumerate(zip(results, places, strict=True)):
        status = missing.get(frame, remove_piece_note(one.status[place.number]))
        if place.piece not in known_pieces:
            known_pieces.add(place.piece)
            status = add_piece_note(status)
        statuses.append(status)
    return statuses


def _picture(folder: Path, number: int) -> Path:
    return folder / PICTURES / f"{number:06d}.jpg"


def _copy_depth(source: Path, target: Path, scale: float) -> None:
    """Copy the depth of a frame, if it has any, with another scale factor and the same values."""
    if not source.exists():
        return
    if scale == 1:
        link_or_copy(source, target)
        return
    with NpzFile(source) as file:
        parts = {name: file.read(name) for name in ("inverse_depth", "inverse_depth_std", "scale")}
    write_npz(target, {**parts, "scale": np.array(float(parts["scale"]) / scale)})
