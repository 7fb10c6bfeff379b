"""Joining of chunks: the folder of the sequence, from the folders of its chunks."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tisfm.camera_file import FILE_NAME as CAMERA
from tisfm.formats.atomic import link_or_copy
from tisfm.formats.npz import NpzFile, write_npz
from tisfm.reconstruction.chunks.moving_objects import write_joined_objects
from tisfm.reconstruction.chunks.placement import ChunkPlacement, ChunkResult
from tisfm.reconstruction.result.folder import CACHE, PICTURES, depth_path, write_mask, write_record
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.statuses import (
    add_piece_note,
    find_cause,
    mark_contradicted,
    remove_piece_note,
)
from tisfm.status import Status


def write_joined_result(
    folder: Path,  # output folder of the joined result, prepared for writing
    parts: Sequence[ChunkResult],
    placements: Sequence[ChunkPlacement],  # placement of each frame of the joined result
    *,
    camera: Reconstruction,  # the result with the common camera
    missing: Mapping[int, Status],  # frames without a given pose, and the reasons
    notes: Sequence[str],  # notes on how the source was read
) -> Reconstruction:
    """Write the joined result; the chunks stay unchanged."""
    first = parts[0].result
    for frame, placement in enumerate(placements):
        source = parts[placement.part].result.folder
        link_or_copy(_picture(source, placement.number), _picture(folder, frame))
        _copy_depth(
            depth_path(source, placement.number), depth_path(folder, frame), placement.scale
        )
    link_or_copy(camera.folder / CAMERA, folder / CAMERA)
    shutil.rmtree(folder / CACHE, ignore_errors=True)
    masks = [mask for part in parts if (mask := part.result.mask) is not None]
    if masks:
        write_mask(folder, np.logical_or.reduce(masks))
    has_objects = first.settings.motion == "objects"
    objects = write_joined_objects(folder, parts, placements) if has_objects else ()
    results = [parts[placement.part].result for placement in placements]
    pieces = [placement.piece for placement in placements]
    checks = _joined_checks(parts, placements)
    skipped = {index: reason for part in parts for index, reason in part.result.skipped}
    result = Reconstruction(
        poses=np.array([placement.pose for placement in placements]),
        piece=np.array(pieces, np.int32),
        unit=(1.0,) * (max(pieces) + 1),
        position_deviation=np.array([[placement.scale] for placement in placements])
        * _of_frames("position_deviation", results, placements),
        rotation_deviation=_of_frames("rotation_deviation", results, placements),
        status=mark_contradicted(
            _statuses(results, placements, missing),
            pieces,
            checks,
            _find_causes(results, placements),
        ),
        checks=checks,
        depth_error=_of_frames("depth_error", results, placements),
        depth_share=_of_frames("depth_share", results, placements),
        keyframes=tuple(
            frame
            for frame, (part_result, placement) in enumerate(zip(results, placements, strict=True))
            if placement.number in part_result.keyframes
        ),
        camera=camera.camera,
        calibration=camera.calibration,
        settings=first.settings,
        names=tuple(
            part_result.names[placement.number]
            for part_result, placement in zip(results, placements, strict=True)
        ),
        times=tuple(
            part_result.times[placement.number]
            for part_result, placement in zip(results, placements, strict=True)
        ),
        skipped=tuple(sorted(skipped.items())),
        notes=tuple(notes),
        shape=first.shape,
        folder=folder,
        version=first.version,
        objects=objects,
    )
    write_record(folder, result)
    return result


def _joined_checks(
    parts: Sequence[ChunkResult], placements: Sequence[ChunkPlacement]
) -> tuple[PathCheck, ...]:
    """Return the checks of the joined pieces: those of all pieces of chunks that they consist of.

    Pairs of frames get the numbers of the joined result.
    """
    indices = sorted({index for part in parts for index in part.frames})
    joined_numbers = {index: number for number, index in enumerate(indices)}
    checks: dict[int, dict[tuple[int, int], PathCheck]] = {}
    for placement in placements:
        part = parts[placement.part]
        node = placement.part, int(part.result.piece[placement.number])
        if placement.piece < 0 or node in checks.setdefault(placement.piece, {}):
            continue
        numbers = {number: joined_numbers[index] for index, number in part.frames.items()}
        checks[placement.piece][node] = part.result.checks[node[1]].renumbered(numbers)
    return tuple(PathCheck.joined(list(checks[piece].values())) for piece in sorted(checks))


def _find_causes(
    results: Sequence[Reconstruction], placements: Sequence[ChunkPlacement]
) -> dict[int, str]:
    """Return what hides the motion in the first contradicted chunk of each joined piece."""
    causes: dict[int, str] = {}
    for result, placement in zip(results, placements, strict=True):
        status = result.status[placement.number]
        if placement.piece >= 0 and status == "contradicted":
            causes.setdefault(placement.piece, find_cause(status))
    return causes


def _statuses(
    results: Sequence[Reconstruction],
    placements: Sequence[ChunkPlacement],
    missing: Mapping[int, Status],
) -> list[Status]:
    """Return the status of each frame; the first frame of each later piece gets a note."""
    statuses, known_pieces = [], {-1, 0}
    for frame, (result, placement) in enumerate(zip(results, placements, strict=True)):
        status = missing.get(frame, remove_piece_note(result.status[placement.number]))
        if placement.piece not in known_pieces:
            known_pieces.add(placement.piece)
            status = add_piece_note(status)
        statuses.append(status)
    return statuses


def _of_frames(
    name: str, results: Sequence[Reconstruction], placements: Sequence[ChunkPlacement]
) -> np.ndarray:
    """Return the values of a field of each frame, (N, …)."""
    return np.array(
        [
            getattr(result, name)[placement.number]
            for result, placement in zip(results, placements, strict=True)
        ]
    )


def _picture(folder: Path, number: int) -> Path:
    return folder / PICTURES / f"{number:06d}.jpg"


def _copy_depth(source: Path, target: Path, scale: float) -> None:
    """Copy the depth file of a frame, if any, with a changed scale factor and the same values."""
    if not source.exists():
        return
    if scale == 1:
        link_or_copy(source, target)
        return
    with NpzFile(source) as file:
        parts = {name: file.read(name) for name in ("inverse_depth", "inverse_depth_std", "scale")}
    write_npz(target, {**parts, "scale": np.array(float(parts["scale"]) / scale)})
