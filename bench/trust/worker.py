"""Process of `bench.trust` that runs one case after the other and judges the results.

It reads a line of JSON for each case from standard input, and prints one line of JSON.
"""

import contextlib
import json
import os
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import tisfm
from bench.trust.cases import FOCALS, SMALL, Case, Clip, all_cases, smoke_cases
from bench.trust.films import render_film
from bench.trust.judge import (
    coverage,
    has_second_motion,
    judge_pair,
    judge_sequence,
    pose_coverage,
)
from bench.trust.worlds import FRAMES, HEIGHT, WIDTH
from tisfm.camera import Camera
from tisfm.datasets import LoadedSequence, find_sequences
from tisfm.formats import read_image
from tisfm.lens import undistort_depth
from tisfm.resampling import ZoomRemoval

MAX_DEPTH = 60.0  # m: larger true depths of real sequences do not count
LASER_SCALE = 256.0  # of the depth maps of kitti_cars, per metre


def settings() -> tisfm.Settings:
    return tisfm.Settings.preset("fast", motion="camera")


def run_sequence(case: Case, data: Path | None, *, is_smoke: bool) -> dict[str, Any]:
    """Reconstruct a sequence; return its verdict."""
    if case.clip is not None:
        assert data is not None
        return _run_clip(case, case.clip, data)
    size, count = SMALL if is_smoke else ((HEIGHT, WIDTH), FRAMES)
    film = render_film(case.scene, case.disturbance, size, count)
    true = Camera(focal=float(film.focal[0]))
    result, seconds = _reconstruct(film.frames, given_camera(true, case.focal))
    maps = [_on_pixels_of(result, k, depth, None) for k, depth in enumerate(film.depth)]
    verdict = judge_sequence(result, film.poses, maps)
    within = _coverage(result, maps)
    if case.has_exact_poses:
        within |= pose_coverage(result, film.poses)
    return verdict | _about(result, true.focal, seconds) | within


def _run_clip(case: Case, clip: Clip, data: Path) -> dict[str, Any]:
    loaded = load_clip(clip, data)
    assert loaded.camera is not None
    camera = given_camera(loaded.camera, case.focal)
    result, seconds = _reconstruct(list(loaded.frames), camera, size=clip.size)
    maps = []
    for k in range(len(loaded.frames)):
        true_depth = loaded.depth(k)
        if true_depth is not None:
            true_depth = np.where(true_depth < MAX_DEPTH, true_depth, np.float32(np.nan))
            true_depth = _on_pixels_of(result, k, true_depth, camera)
        maps.append(true_depth)
    poses = loaded.poses if loaded.posed.all() else None
    verdict = judge_sequence(result, poses, maps, clip.truth_deviation)
    shrunk = max(result.shape) / max(read_image(loaded.frames[0]).shape)
    about = _about(result, loaded.camera.focal * shrunk, seconds)
    within = _coverage(result, maps)
    if case.has_exact_poses:
        within |= pose_coverage(result, poses)
    return verdict | about | within


def run_pair(case: Case, data: Path | None, *, is_smoke: bool) -> dict[str, Any]:
    """Interpret a pair; return its verdict."""
    depth: NDArray | None
    if case.clip is not None:
        assert data is not None
        loaded = load_clip(case.clip, data)
        assert loaded.camera is not None
        true, poses = loaded.camera, loaded.poses if loaded.posed.all() else None
        frames = [read_image(loaded.frames[k]) for k in case.frames]
        depth = loaded.depth(case.frames[0])
        if depth is not None:
            depth = np.where(depth < MAX_DEPTH, depth, np.float32(np.nan))
    else:
        size, count = SMALL if is_smoke else ((HEIGHT, WIDTH), FRAMES)
        film = render_film(case.scene, case.disturbance, size, count)
        true, poses = Camera(focal=float(film.focal[case.frames[0]])), film.poses
        frames, depth = [film.frames[k] for k in case.frames], film.depth[case.frames[0]]
    camera = given_camera(true, case.focal)
    begin = time.process_time()
    result = tisfm.interpret(*frames, camera=camera, settings=settings())
    seconds = time.process_time() - begin
    if depth is not None and camera is not None and camera.distortion is not None:
        depth = undistort_depth(depth, camera)
    first, second = case.frames
    motion = None if poses is None else np.linalg.inv(poses[second]) @ poses[first]
    about = {
        "focal": result.camera.focal,
        "true focal": true.focal,
        "seconds": round(seconds, 2),
        "two motions": has_second_motion(depth, motion, true.focal),
    }
    return judge_pair(result, motion, depth) | about


def _reconstruct(
    frames: Any, camera: Camera | None, **options: Any
) -> tuple[tisfm.Reconstruction, float]:
    begin = time.process_time()
    result = tisfm.reconstruct(frames, camera=camera, settings=settings(), **options)
    for index in range(len(result)):  # some depth maps are only computed when they are read
        result.inverse_depth(index)
    return result, time.process_time() - begin


def _about(result: tisfm.Reconstruction, true: float, seconds: float) -> dict[str, Any]:
    """Return what the result says of the camera, and the processor time."""
    calibration = result.calibration
    deviation = calibration.relative_focal_std
    mask = result.mask
    return {
        "focal": result.camera.focal,
        "true focal": true,
        "focal deviation": result.camera.focal * deviation if np.isfinite(deviation) else None,
        "focal origin": calibration.origin,
        "focal seen": calibration.seen,
        "radial": calibration.radial,
        "readout": calibration.readout,
        "masked": 0.0 if mask is None else float(mask.mean()),
        "seconds": round(seconds, 2),
    }


def _coverage(
    result: tisfm.Reconstruction, maps: Sequence[NDArray | None]
) -> dict[str, list[float]]:
    """Return the mean shares of pixels within one and two deviations of their depth."""
    shares = [
        found
        for index, truth in enumerate(maps)
        if (found := coverage(result.inverse_depth(index), result.inverse_depth_std(index), truth))
    ]
    return {"within": np.mean(shares, axis=0).tolist()} if shares else {}


def given_camera(true: Camera, focal: str) -> Camera | None:
    """Return the camera that the program gets."""
    factor = FOCALS[focal]
    return None if factor is None else replace(true, focal=true.focal * factor)


def _on_pixels_of(
    result: tisfm.Reconstruction, frame: int, depth: NDArray[np.float32], camera: Camera | None
) -> NDArray[np.float32]:
    """Return the true depth of a frame on the pixels of a result, without distortion and zoom."""
    if result.zoom is not None:
        center = result.camera.center_for(*depth.shape)
        depth = ZoomRemoval(result.zoom[frame], center, depth.shape).apply_nearest(depth)
    radial = result.calibration.radial
    if camera is not None and camera.distortion is not None:
        depth = undistort_depth(depth, camera)
    elif radial:
        scale = depth.shape[1] / result.shape[1]
        lens = Camera(focal=result.camera.focal * scale, distortion=(radial, 0.0, 0.0, 0.0))
        depth = undistort_depth(depth, lens)
    height, width = result.shape
    return np.asarray(cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST))


@lru_cache(maxsize=4)
def load_clip(clip: Clip, data: Path) -> LoadedSequence:
    """Return the frames and the truth of a clip."""
    (sequence,) = find_sequences(data / clip.folder)
    loaded = sequence.load(1)
    stop = min(clip.start + clip.count * clip.step, len(loaded.frames))
    taken = loaded.take(range(clip.start, stop, clip.step))
    return replace(taken, depth_scale=LASER_SCALE) if clip.folder == "kitti_cars" else taken


def main() -> None:
    from tisfm import runtime

    data = os.environ.get("TISFM_DATA")
    with contextlib.redirect_stdout(sys.stderr):  # for the output of libraries
        runtime.start(threads=1)
    warnings.simplefilter("ignore")
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        question = json.loads(line)
        cases = smoke_cases() if question["smoke"] else all_cases()
        (case,) = [case for case in cases if case.name == question["case"]]
        with contextlib.redirect_stdout(sys.stderr):
            try:
                run = run_sequence if case.task == "sequence" else run_pair
                answer = run(case, Path(data) if data else None, is_smoke=question["smoke"])
            except Exception as error:
                answer = {"failure": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
