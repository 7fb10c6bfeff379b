"""The common camera of all chunks, found with some chunks before all are reconstructed."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.camera_file import FILE_NAME, read_camera, read_camera_record, write_camera
from tisfm.reconstruction.chunks.chunk import Chunk, make_chunk
from tisfm.reconstruction.chunks.settings import CHUNKING
from tisfm.reconstruction.result.reconstruction import Reconstruction

UnorderedMap = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[tuple[int, Any]]]
"""Calls a function with each item, in any process; yields the number and result of each item."""


@dataclass(frozen=True, kw_only=True)
class SharedCamera:
    """A camera for all chunks, and the result that contains this camera."""

    # camera file, for the frames of the source; its readout time is known, and it states whether
    # the focal length is a guess
    camera: Path
    result: Reconstruction  # a path without depth


def needs_calibration(chunk: Chunk, camera: Camera | None) -> bool:
    """Return whether any parameter of the camera has to be estimated from the frames."""
    if chunk.poses is not None:
        return False
    return chunk.calibrate != "nothing" or camera is None or camera.readout is None


def shared_camera(
    chunks: Sequence[Chunk],  # all chunks, before the camera is known
    map_unordered: UnorderedMap,
    folder: Path,  # folder for the camera file and for the camera paths of tried chunks
) -> SharedCamera:
    """Find the camera from the first chunk, or from other chunks if the first chunk fails.

    Raises Exception: as `tisfm.reconstruct`.
    """
    first, *others = [
        replace(chunk, folder=folder / f"camera-{number:03d}", depth_of="none")
        for number, chunk in enumerate(chunks)
    ]
    results = [result for _, result in _complete_results([first], map_unordered)]
    if not results[0].calibration.seen and others:
        count = min(CHUNKING.max_tried_chunks - 1, len(others))
        indices = np.unique(np.linspace(0, len(others) - 1, count).astype(int))
        candidates = [others[number] for number in indices]
        results += [
            result
            for _, result in sorted(
                _complete_results(candidates, map_unordered), key=lambda result: result[0]
            )
        ]
    best_result = next((result for result in results if result.calibration.seen), None)
    if best_result is None:
        best_result = min(results, key=_relative_deviation)
    camera, record = read_camera(best_result.folder), read_camera_record(best_result.folder)
    if camera.readout is None:  # unknown: chunks must not search again
        camera = replace(camera, readout=0.0)
    shape = record["height"], record["width"]
    write_camera(folder / FILE_NAME, camera, shape, about=record)
    return SharedCamera(camera=folder / FILE_NAME, result=best_result)


def _relative_deviation(result: Reconstruction) -> float:
    """Return the relative standard deviation of the focal length; infinite for a guess."""
    calibration = result.calibration
    return calibration.focal_std / calibration.focal if calibration.focal else np.inf


def _complete_results(
    chunks: Sequence[Chunk], map_unordered: UnorderedMap
) -> Iterator[tuple[int, Reconstruction]]:
    for number in complete_chunks(chunks, map_unordered):
        yield number, Reconstruction.load(chunks[number].folder)


def complete_chunks(chunks: Sequence[Chunk], map_unordered: UnorderedMap) -> Iterator[int]:
    """Make the incomplete chunks; yield the numbers of all chunks as they become complete.

    Raises Exception: as `tisfm.reconstruct`.
    """
    missing_numbers = []
    for number, chunk in enumerate(chunks):
        if chunk.is_complete():
            yield number
        else:
            missing_numbers.append(number)
    for number, error in map_unordered(make_chunk, [chunks[number] for number in missing_numbers]):
        if error is not None:
            raise error
        yield missing_numbers[number]
