"""``python -m bench.view``: the viewer on long results, in a real browser.

A long result has the files of a short run or reconstruction, linked many times. The viewer then
reads as many files, of the same size, as in a real long result.
"""

import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.shared.command import options_parser
from bench.shared.results import (
    RESULTS,
    Bar,
    Table,
    exit_code,
    machine,
    markdown_page,
    write_results,
)
from bench.view.opening import Opening, browser, measure_opening
from tisfm.cli.command_line import main as tisfm_command
from tisfm.formats import write_png
from tisfm.reconstruction.result.folder import DEPTH, PICTURES, depth_path, write_record
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.rigid import pose_matrix
from tisfm.scenes import room_film

FRAMES = 1000  # of each result
SHORT_FRAMES = 8  # frames of the short results that are repeated
HEIGHT = 480  # px
WIDTH = 640  # px
ROUNDS = 5  # starts of the command on each result
STEPS = 6  # of the slider in each start
MAX_SECONDS = 3.0  # s until points are visible; set by hand
NAMES = {"run": "`tisfm run`", "reconstruction": "`tisfm reconstruct`"}
HEAD = (
    "", "frames", "page served, s", "points visible, s", "in the slowest start, s",
    "processor until then, s", "all points arrived, s", "step of the slider, s",
    "its points arrived, s", "memory, MB", "peak, MB",
)  # fmt: skip
CAMERA_MOTION = np.array((0.1, 0.0, 0.04, 0.0, 0.01, 0.0))  # per frame, m and rad
DRIFT = 0.01  # m per frame, added to the long path so that no two cameras coincide


def bars(results: Mapping[str, Sequence[Opening]]) -> list[Bar]:
    return [
        Bar(f"{NAMES[kind]}: s to visible points", median(o.first for o in openings), MAX_SECONDS)
        for kind, openings in results.items()
    ]


def report(
    results: Mapping[str, Sequence[Opening]], frames: int, conditions: Mapping[str, Any]
) -> str:
    table = Table(HEAD, [_row(kind, openings, frames) for kind, openings in results.items()])
    notes = [
        *map(str, bars(results)),
        "Times start with `tisfm view`. The browser, a headless Chromium without a GPU, is already "
        "open and draws on the same cores as the command. Medians over starts, of steps over all "
        "of them. Steps go to frames that were not shown before. Memory of the command: after the "
        "first picture, and its peak.",
    ]
    return markdown_page("# The viewer on long results", conditions, table, notes)


def _row(kind: str, openings: Sequence[Opening], frames: int) -> list[str]:
    steps = [step for opening in openings for step in opening.steps]
    values = [
        median(o.served for o in openings),
        median(o.first for o in openings),
        max(o.first for o in openings),
        median(o.processor for o in openings),
        median(o.refined for o in openings),
        median(display_time for display_time, _ in steps),
        median(refined for _, refined in steps),
    ]
    sizes = [_size([o.memory for o in openings]), _size([o.peak for o in openings])]
    cells = [NAMES[kind], str(frames), *(f"{value:.2f}" for value in values), *sizes]
    return cells


def _size(values: Sequence[float | None]) -> str:
    known_values = [value for value in values if value is not None]
    return f"{median(known_values):.0f}" if known_values else "–"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write ``bench/results/view.md``, and return 1 if the bar is missed."""
    parser = options_parser("view", __doc__, "smoke", "output", output="view")
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each result")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="starts of the command on each")
    options = parser.parse_args(arguments)
    frames, rounds, steps, size = options.frames, options.rounds, STEPS, (HEIGHT, WIDTH)
    if options.smoke:
        frames, rounds, steps, size = 30, 1, 2, (240, 320)
    results: dict[str, list[Opening]] = {"run": [], "reconstruction": []}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        focal = write_frames(folder / "frames", SHORT_FRAMES, *size)
        write_short(folder / "frames", focal, folder / "short_run", folder / "short_reconstruction")
        lengthen_run(folder / "short_run", folder / "run", frames)
        lengthen_reconstruction(folder / "short_reconstruction", folder / "reconstruction", frames)
        try:
            with browser() as chromium:
                version = chromium.version
                for turn in range(rounds + (not options.smoke)):
                    for kind, openings in results.items():
                        first = 1 + turn * steps
                        frame_numbers = [
                            (k * frames // (steps + 1) + first) % frames for k in range(1, 7)
                        ]
                        opening = measure_opening(chromium, folder / kind, frame_numbers[:steps])
                        if turn or options.smoke:  # else it reads cold files
                            openings.append(opening)
        except RuntimeError as error:
            print(f"bench.view: {error}", file=sys.stderr)
            return 1
    about = {"frames": f"{size[0]} × {size[1]} px", "Chromium": version, **machine()}
    text = report(results, frames, about)
    print(text)
    if options.smoke:
        return 0
    write_results(RESULTS / options.output, text)
    return exit_code(bars(results))


def write_frames(folder: Path, count: int, height: int, width: int) -> float:
    """Write frames of a room with patterned walls as PNG files; return the focal length, px."""
    folder.mkdir()
    poses = np.array([pose_matrix(k * CAMERA_MOTION) for k in range(count)])
    film = room_film(poses, height, width, textured=True, samples=1)
    for k, frame in enumerate(film.frames):
        write_png(folder / f"{k:04d}.png", frame)
    return film.camera.focal


def write_short(frames: Path, focal: float, run: Path, reconstruction: Path) -> None:
    """Write the run and the reconstruction of a few frames.

    Raise RuntimeError if a command fails.
    """
    commands = (
        ["run", str(frames), "-o", str(run), "--motion", "camera", "--no-figures"],
        ["reconstruct", str(frames), "-o", str(reconstruction)],
    )
    for arguments in commands:
        code = tisfm_command([*arguments, "--preset", "fast", "--focal", f"{focal:g}"])
        if code != 0:
            raise RuntimeError(f"tisfm {arguments[0]} ended with exit code {code}")


def lengthen_run(short: Path, long: Path, count: int) -> None:
    """Write a run of `count` pairs, which repeats the pairs of a short one."""
    long.mkdir()
    record = json.loads((short / "run.json").read_text(encoding="utf-8"))
    pairs = list(record["pairs"].items())
    long_result = {}
    for k in range(count):
        name, pair = pairs[k % len(pairs)]
        os.link(short / f"{name}.npz", long / f"{k:06d}.npz")
        long_result[f"{k:06d}"] = {**pair, "number": k}
    text = json.dumps({**record, "pairs": long_result}, indent=1)
    (long / "run.json").write_text(text, encoding="utf-8")


def lengthen_reconstruction(short: Path, long: Path, count: int) -> None:
    """Write a reconstruction of `count` frames that runs to and fro through a short one.

    Raise ValueError if a frame of the short one has no pose.
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
    poses[:, 0, 3] += DRIFT * np.arange(count)
    long_result = replace(
        result,
        poses=poses,
        piece=np.zeros(count, np.int32),
        position_deviation=result.position_deviation[numbers],
        rotation_deviation=result.rotation_deviation[numbers],
        status=tuple(result.status[number] for number in numbers),
        depth_error=result.depth_error[numbers],
        depth_share=result.depth_share[numbers],
        names=tuple(f"{k:06d}" for k in range(count)),
        times=tuple(k / 30 for k in range(count)),
        folder=long,
    )
    write_record(long, long_result)


if __name__ == "__main__":
    raise SystemExit(main())
