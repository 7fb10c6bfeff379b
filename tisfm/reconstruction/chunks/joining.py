"""The folder of a whole sequence, joined from the folders of its chunks."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tisfm.camera_file import NAME as CAMERA
from tisfm.formats.atomic import link_or_copy
from tisfm.formats.npz import NpzFile, write_npz
from tisfm.reconstruction.chunks.placement import ChunkPlacement, ChunkResult
from tisfm.reconstruction.pipeline import add_piece_note, remove_piece_note
from tisfm.reconstruction.result.folder import CACHE, PICTURES, depth_path, write_record
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.status import Status


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
        _take_depth(depth_path(source, place.number), depth_path(folder, frame), place.scale)
    link_or_copy(camera.folder / CAMERA, folder / CAMERA)
    shutil.rmtree(folder / CACHE, ignore_errors=True)
    results = [parts[place.part].result for place in places]
    skipped = {index: why for part in parts for index, why in part.result.skipped}
    result = Reconstruction(
        poses=np.array([place.pose for place in places]),
        piece=np.array([place.piece for place in places], np.int32),
        unit=(1.0,) * (max(place.piece for place in places) + 1),
        status=tuple(_statuses(results, places, missing)),
        keyframes=tuple(
            frame
            for frame, (one, place) in enumerate(zip(results, places, strict=True))
            if place.number in one.keyframes
        ),
        camera=camera.camera,
        calibration=camera.calibration,
        settings=first.settings,
        names=tuple(one.names[at.number] for one, at in zip(results, places, strict=True)),
        times=tuple(one.times[at.number] for one, at in zip(results, places, strict=True)),
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
    found, begun = [], {-1, 0}
    for frame, (one, place) in enumerate(zip(results, places, strict=True)):
        status = missing.get(frame, remove_piece_note(one.status[place.number]))
        if place.piece not in begun:
            begun.add(place.piece)
            status = add_piece_note(status)
        found.append(status)
    return found


def _picture(folder: Path, number: int) -> Path:
    return folder / PICTURES / f"{number:06d}.jpg"


def _take_depth(source: Path, target: Path, scale: float) -> None:
    """Copy the depth of a frame, if it has any, with another scale factor and the same values."""
    if not source.exists():
        return
    if scale == 1:
        link_or_copy(source, target)
        return
    with NpzFile(source) as file:
        parts = {name: file.read(name) for name in ("inverse_depth", "inverse_depth_std", "scale")}
    write_npz(target, {**parts, "scale": np.array(float(parts["scale"]) / scale)})
