"""Process of `bench.sequences` that runs a method of tisfm on a sequence.

It reads one line of JSON from standard input and prints one.
"""

import contextlib
import gc
import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import tisfm
from bench.pair_memory import peak, restart
from bench.sequences.chained import chain
from bench.sequences.stored import store, store_map
from tisfm import runtime
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.formats import read_image
from tisfm.lens import undistort


def run(request: dict[str, Any]) -> dict[str, Any]:
    """Run a method and store its results; return their names, seconds and peak memory in bytes."""
    runtime.start(threads=request["threads"])
    settings = tisfm.Settings.preset(request["preset"], motion="camera")
    camera = tisfm.Camera(**request["camera"])
    frames = tuple(map(Path, request["frames"]))
    first = [undistort(read_image(path), camera) for path in frames[:2]]
    tisfm.interpret(*first, camera=camera.pinhole(), settings=settings)  # compiles kernels
    del first
    gc.collect()
    restart()
    method = {"reconstruct": _reconstructed, "chain": _chained}[request["method"]]
    return method(request, frames, camera, settings) | {"peak": peak()}


def _reconstructed(
    request: dict[str, Any],
    frames: tuple[Path, ...],
    camera: tisfm.Camera,
    settings: tisfm.Settings,
) -> dict[str, Any]:
    folder = Path(request["output"])
    poses = np.array(request["poses"]) if request["poses"] is not None else None
    started = time.perf_counter()
    known = camera if request["camera_given"] else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GuessedFocalWarning)
        result = tisfm.reconstruct(frames, camera=known, settings=settings, poses=poses)
    for index in range(len(frames)):  # some depth maps are only computed when they are read
        result.inverse_depth(index)
    seconds = time.perf_counter() - started
    for index in range(len(frames)):
        inverse = result.inverse_depth(index)
        if np.isfinite(inverse).any():
            store_map(folder, index, inverse, result.inverse_depth_std(index))
    store(
        folder,
        "result",
        poses=result.poses,
        piece=[int(piece) for piece in result.piece],
        status=[str(status) for status in result.status],
    )
    found = result.calibration
    length = found.focal or result.camera.focal  # in px of the source, like the deviation
    deviation = found.focal_std if found.origin == "estimated" else length
    focal = length, deviation, found.seen
    return {"results": {"": "result"}, "seconds": seconds, "focal": focal}


def _chained(
    request: dict[str, Any],
    frames: tuple[Path, ...],
    camera: tisfm.Camera,
    settings: tisfm.Settings,
) -> dict[str, Any]:
    folder, pinhole = Path(request["output"]), camera.pinhole()
    read: dict[int, np.ndarray] = {}
    storing = 0.0

    def frame(index: int) -> np.ndarray:
        if index not in read:
            for old in [key for key in read if abs(key - index) > 1]:
                del read[old]
            read[index] = undistort(read_image(frames[index]), camera)
        return read[index]

    def interpret(first: int, second: int) -> tisfm.Interpretation:
        return tisfm.interpret(frame(first), frame(second), camera=pinhole, settings=settings)

    def keep(index: int, result: tisfm.Interpretation) -> None:
        nonlocal storing
        began = time.perf_counter()
        store_map(folder, index, result.inverse_depth, result.inverse_depth_std)
        storing += time.perf_counter() - began

    started = time.perf_counter()
    center = pinhole.center_for(*frame(0).shape[:2])
    found = chain(len(frames), interpret, keep, focal=pinhole.focal, center=center)
    seconds = time.perf_counter() - started - storing
    store(
        folder,
        "chained",
        poses=np.array(found.poses),
        piece=found.piece,
        status=found.status,
        units=found.units,
    )
    nothing = [-1] * len(frames)
    without = np.full((len(frames), 4, 4), np.nan)
    store(folder, "pairs", poses=without, piece=nothing, status=found.status)
    return {"results": {"chained pairs": "chained", "pairs": "pairs"}, "seconds": seconds}


if __name__ == "__main__":
    question = json.loads(sys.stdin.readline())
    with contextlib.redirect_stdout(sys.stderr):  # for the output of libraries
        answer = run(question)
    print(json.dumps(answer))
