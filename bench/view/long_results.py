"""Long results for the viewer: the files of a short run or reconstruction, linked many times.

The viewer then reads as many files, of the same size, as in a real long result.
"""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from tisfm.cli.command_line import main as tisfm_command
from tisfm.formats import write_png
from tisfm.reconstruction.result.folder import DEPTH, PICTURES, depth_path, write_record
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.rigid import pose_matrix
from tisfm.scenes import room_film

_STEP = np.array((0.1, 0.0, 0.04, 0.0, 0.01, 0.0))  # motion of the camera per frame, m and rad
_DRIFT = 0.01  # m per frame, added to the long path so that no two cameras coincide


def write_frames(folder: Path, count: int, height: int, width: int) -> float:
    """Write frames of a room with patterned walls as PNG files; return the focal length, px."""
    folder.mkdir()
    poses = np.array([pose_matrix(k * _STEP) for k in range(count)])
    film = room_film(poses, height, width, textured=True, samples=1)
    for k, frame in enumerate(film.frames):
        write_png(folder / f"{k:04d}.png", frame)
    return film.camera.focal


def write_short(frames: Path, focal: float, run: Path, reconstruction: Path) -> None:
    """Write the run and the reconstruction of a few frames.

    Raises
    ------
    RuntimeError
        If a command fails.
    """
    commands = (
        ["run", str(frames), "-o", str(run), "--motion", "camera", "--no-figures"],
        ["reconstruct", str(frames), "-o", str(reconstruction)],
    )
    for arguments in commands:
        code = tisfm_command([*arguments, "--preset", "fast", "--focal", f"{focal:g}"])
        if code != 0:
            raise RuntimeError(f"tisfm {arguments[0]} ended with exit code {code}")


def lengthened_run(short: Path, long: Path, count: int) -> None:
    """Write a run of `count` pairs, which repeats the pairs of a short one."""
    long.mkdir()
    record = json.loads((short / "run.json").read_text(encoding="utf-8"))
    pairs = list(record["pairs"].items())
    longer = {}
    for k in range(count):
        name, pair = pairs[k % len(pairs)]
        os.link(short / f"{name}.npz", long / f"{k:06d}.npz")
        longer[f"{k:06d}"] = {**pair, "number": k}
    text = json.dumps({**record, "pairs": longer}, indent=1)
    (long / "run.json").write_text(text, encoding="utf-8")


def lengthened_reconstruction(short: Path, long: Path, count: int) -> None:
    """Write a reconstruction of `count` frames that runs to and fro through a short one.

    Raises
    ------
    ValueError
        If a frame of the short one has no pose.
    """
    result = Reconstruction.load(short)
    if (result.piece != 0).any():
        raise ValueError("the short reconstruction is in several pieces: expected one")
    turn = [*range(len(result)), *range(len(result) - 2, 0, -1)]
    numbers = [turn[k % len(turn)] for k in range(count)]
    for part in (DEPTH, PICTURES):
        (long / part).mkdir(parents=True)
    for k, number in enumerate(numbers):
        os.link(depth_path(short, number), depth_path(long, k))
        os.link(short / PICTURES / f"{number:06d}.jpg", long / PICTURES / f"{k:06d}.jpg")
    poses = result.poses[numbers].copy()
    poses[:, 0, 3] += _DRIFT * np.arange(count)
    longer = replace(
        result,
        poses=poses,
        piece=np.zeros(count, np.int32),
        status=tuple(result.status[number] for number in numbers),
        names=tuple(f"{k:06d}" for k in range(count)),
        times=tuple(k / 30 for k in range(count)),
        folder=long,
    )
    write_record(long, longer)
