"""Process of `bench.sequences` that runs a method of tisfm on a sequence.

The methods are `tisfm.reconstruct`, and a chain of pairs: the depth of earlier pairs gives the
scale of each pair. The process reads one line of JSON from standard input and prints one.
"""

import contextlib
import gc
import json
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tisfm
from bench.pair_memory import peak, reset_peak
from bench.sequences.stored import store, store_map
from tisfm import runtime
from tisfm.evaluation.pair_errors import LITTLE_PARALLAX_STATUSES
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.formats import read_image
from tisfm.interpretation import Interpretation
from tisfm.lens import undistort
from tisfm.rigid import pose_matrix

STRIDE = 4  # px between the pixels whose points are passed to the next pair
MIN_OVERLAP = 0.003  # share of these pixels with both depths for a known scale; set by hand

# Arguments: a frame, and the other frame of its pair.
Interpret = Callable[[int, int], Interpretation]
# Arguments: a frame, and the interpretation with its depth.
Keep = Callable[[int, Interpretation], None]


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
    reset_peak()
    method = {"reconstruct": _reconstruct, "chain": _chain_pairs}[request["method"]]
    return method(request, frames, camera, settings) | {"peak": peak()}


def _reconstruct(
    request: dict[str, Any],
    frames: tuple[Path, ...],
    camera: tisfm.Camera,
    settings: tisfm.Settings,
) -> dict[str, Any]:
    folder = Path(request["output"])
    poses = np.array(request["poses"]) if request["poses"] is not None else None
    start_time = time.perf_counter()
    given_camera = camera if request["camera_given"] else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GuessedFocalWarning)
        result = tisfm.reconstruct(frames, camera=given_camera, settings=settings, poses=poses)
    for index in range(len(frames)):  # some depth maps are only computed when they are read
        result.inverse_depth(index)
    seconds = time.perf_counter() - start_time
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
        keyframes=list(result.keyframes),
    )
    calibration = result.calibration
    length = calibration.focal or result.camera.focal  # in px of the source, like the deviation
    deviation = calibration.focal_std if calibration.origin == "estimated" else length
    focal = length, deviation, calibration.seen
    return {"results": {"": "result"}, "seconds": seconds, "focal": focal}


def _chain_pairs(
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
        begin = time.perf_counter()
        store_map(folder, index, result.inverse_depth, result.inverse_depth_std)
        storing += time.perf_counter() - begin

    start_time = time.perf_counter()
    center = pinhole.center_for(*frame(0).shape[:2])
    chained = chain(len(frames), interpret, keep, focal=pinhole.focal, center=center)
    seconds = time.perf_counter() - start_time - storing
    store(
        folder,
        "chained",
        poses=np.array(chained.poses),
        piece=chained.piece,
        status=chained.status,
        units=chained.units,
    )
    no_pieces = [-1] * len(frames)
    no_poses = np.full((len(frames), 4, 4), np.nan)
    store(folder, "pairs", poses=no_poses, piece=no_pieces, status=chained.status)
    return {"results": {"chained pairs": "chained", "pairs": "pairs"}, "seconds": seconds}


@dataclass(kw_only=True)
class Chain:
    poses: list[NDArray[np.float64]] = field(default_factory=list)  # (4, 4), camera to world
    piece: list[int] = field(default_factory=list)  # number of the segment, which has one scale
    status: list[str] = field(default_factory=list)
    units: list[float] = field(default_factory=list)  # of the frame's pair, in units of the segment


def chain(
    count: int,  # frames, at least 2
    interpret: Interpret,
    keep: Keep,  # called with every frame that has a depth
    *,
    focal: float,  # px
    center: tuple[float, float],  # principal point, px
) -> Chain:
    """Chain the pairs of consecutive frames.

    The points of the previous frame, moved by its pair, have the scale of the segment. The median
    ratio of their depth to the depth of this frame's pair is the unit of the pair. A pair without
    depth only turns the camera, and the points are passed on. The last frame has the depth of the
    reversed pair.
    """
    chained = Chain()
    pose, piece = np.eye(4), 0
    # (3, K), in the axes of this frame and the scale of the segment.
    points: NDArray[np.float64] | None = None
    for index in range(count):
        last = index == count - 1
        result = interpret(index, index - 1) if last else interpret(index, index + 1)
        has_depth = result.status not in LITTLE_PARALLAX_STATUSES and result.motions is not None
        unit = _unit(points, result.inverse_depth, focal, center) if has_depth else 1.0
        if unit is None:  # the scale is lost: a new segment begins
            pose, piece, unit = np.eye(4), piece + 1, 1.0
        chained.poses.append(pose)
        chained.piece.append(piece)
        chained.status.append(str(result.status))
        chained.units.append(unit)
        if has_depth:
            keep(index, result)
        if result.motions is None:
            continue
        motion = pose_matrix(result.motions[0])
        motion[:3, 3] *= unit if has_depth else 0.0
        if has_depth:
            points = _points(result.inverse_depth, focal, center) * unit
        if points is not None:
            points = motion[:3, :3] @ points + motion[:3, 3:]
        pose = pose @ np.linalg.inv(motion)
    return chained


def _points(
    inverse_depth: NDArray, focal: float, center: tuple[float, float]
) -> NDArray[np.float64]:
    """Return the points of some pixels, (3, K), in camera axes and the unit of the pair."""
    rows, columns = np.mgrid[: inverse_depth.shape[0] : STRIDE, : inverse_depth.shape[1] : STRIDE]
    inverse = inverse_depth[rows, columns].astype(np.float64)
    has_depth = np.isfinite(inverse) & (inverse > 0)
    rays = np.stack(
        [
            (columns[has_depth] - center[0]) / focal,
            (rows[has_depth] - center[1]) / focal,
            np.ones(np.count_nonzero(has_depth)),
        ]
    )
    return rays / inverse[has_depth]


def _unit(
    points: NDArray | None, inverse_depth: NDArray, focal: float, center: Sequence[float]
) -> float | None:
    """Return the median of earlier depth over depth of this pair; None for too little overlap.

    It is 1 without earlier points: the first pair with depth defines the unit.
    """
    if points is None:
        return 1.0
    ahead = points[:, points[2] > 0]
    x = np.rint(focal * ahead[0] / ahead[2] + center[0])
    y = np.rint(focal * ahead[1] / ahead[2] + center[1])
    height, width = inverse_depth.shape
    is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    inverse_here = inverse_depth[y[is_inside].astype(np.intp), x[is_inside].astype(np.intp)]
    ratios = ahead[2, is_inside] * inverse_here
    ratios = ratios[np.isfinite(ratios) & (ratios > 0)]
    min_count = MIN_OVERLAP * inverse_depth.size / STRIDE**2
    return float(np.median(ratios)) if len(ratios) > min_count else None


if __name__ == "__main__":
    question = json.loads(sys.stdin.readline())
    with contextlib.redirect_stdout(sys.stderr):  # for the output of libraries
        answer = run(question)
    print(json.dumps(answer))
