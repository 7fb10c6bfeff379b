"""``python -m bench.sequences.long_runs``: speed of workers, long runs, and killed runs.

Workers: a video on a local Dask cluster, of one worker with one thread and of two, in turns. The
speed is measured from the pair after which every worker has begun, to leave out the start, to the
last pair. Frames: resident memory and speed of a run over many small frames, after a hundred pairs
and at the end. Kills: four commands are killed by SIGKILL at random moments and resumed: a run, a
run of two workers, a run on a local Dask cluster of two workers, and a reconstruction in chunks by
two workers. Their files are compared with the files of an uninterrupted command. The tables are
written to bench/results/long_runs.md.
"""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.sequences.rendered_films import circle_path as rounds_of
from bench.shared.command import options_parser
from bench.shared.results import (
    RESULTS,
    Bar,
    Table,
    exit_code,
    machine,
    markdown_page,
    process_memory,
    write_results,
)
from bench.writing import render_frames
from tisfm.formats import write_png
from tisfm.scenes import room_film, static_scene

MIN_SPEEDUP = 1.7  # speed of two workers over the speed of one; set by hand
MAX_CHANGE = 0.05  # relative growth of memory and loss of speed in a long run; set by hand
ROUNDS = 3  # rounds of the speed of workers
PAIRS = 120  # pairs of the video for workers
FRAMES = 10_000  # frames of the long run
KILLS = 20  # kills of each command
START_PAIRS = 12  # pairs after which every worker has begun
EARLY_PAIRS = 100  # pairs after which memory and speed are first measured
SPEED_PAIRS = 1000  # pairs over which a speed is measured
FRAME_SIZE = (48, 64)  # px, height and width of the frames of the long run
COMMAND = [sys.executable, "-c", "import sys; from tisfm.cli.command_line import main; "
           "sys.exit(main())"]  # fmt: skip
RUN = ("run", "--preset", "fast", "--no-figures")
RECONSTRUCT = ("reconstruct", "--preset", "fast", "--workers", "2", "--chunk", "16")


@dataclass
class Results:
    """The figures; figures of skipped parts are empty."""

    workers: list[tuple[float, float]] = field(default_factory=list)  # pairs/s of one and two
    frames: dict[str, float] = field(default_factory=dict)
    kills: dict[str, dict[str, int]] = field(default_factory=dict)


def start(*options: str, command: Sequence[str] = RUN) -> subprocess.Popen[bytes]:
    call = [*COMMAND, *command, *options]
    return subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def wait_for(process: subprocess.Popen[bytes]) -> None:
    """Wait for the end of a command; raise RuntimeError if it failed."""
    _, messages = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"a run ended with {process.returncode}: {messages.decode()}")


def finish_times(folder: Path) -> list[float]:
    """Return the times at which the pairs of a run were finished, s, in order."""
    return sorted(path.stat().st_mtime for path in folder.glob("*.npz"))


def speed(times: Sequence[float], first: int, last: int) -> float:
    """Return the pairs per second between the pairs with the numbers `first` and `last`."""
    return (last - first) / (times[last - 1] - times[first - 1])


def measure_workers(source: Path, rounds: int, start_pairs: int) -> list[tuple[float, float]]:
    """Return pairs per second of one and of two workers with one thread each, for every round."""
    speeds = []
    for _ in range(rounds):
        speeds_of_round = []
        for workers in (1, 2):
            with tempfile.TemporaryDirectory() as folder, cluster(workers) as address:
                wait_for(start(str(source), "-o", folder, "--cluster", address, "--threads", "1"))
                times = finish_times(Path(folder))
                speeds_of_round.append(speed(times, start_pairs, len(times)))
        speeds.append((speeds_of_round[0], speeds_of_round[1]))
    return speeds


def many_frames(folder: Path, count: int) -> Path:
    """Make a folder of small frames: two frames of a scene alternate, as hard links."""
    scene = static_scene("sideways", *FRAME_SIZE)
    files = []
    for number, frame in enumerate((scene.frame0, scene.frame1)):
        files.append(folder / f"kind{number}.png")
        write_png(files[-1], np.clip(np.rint(frame), 0, 255).astype(np.uint8))
    target = folder / "frames"
    target.mkdir()
    for number in range(count):
        os.link(files[number % 2], target / f"frame{number:06d}.png")
    return target


def measure_frames(count: int) -> dict[str, float]:
    """Return memory and speed of a run over `count` frames, early and at the end."""
    with tempfile.TemporaryDirectory() as folder:
        source, output = many_frames(Path(folder), count), Path(folder, "out")
        process = start(str(source), "-o", str(output), "--figures", "500")
        early, last = 0.0, 0.0
        while process.poll() is None:
            time.sleep(0.2)
            last = (process_memory("VmRSS", process.pid) or 0.0) / 1e6 or last
            if early == 0 and output.exists() and len(os.listdir(output)) > 4 * EARLY_PAIRS:
                early = last
        wait_for(process)
        times = finish_times(output)
        segment = min(SPEED_PAIRS, len(times) // 4)
        return {
            "pairs": len(times),
            "memory early, MB": early,
            "memory at the end, MB": last,
            "pairs/s early": speed(times, EARLY_PAIRS, EARLY_PAIRS + segment),
            "pairs/s at the end": speed(times, len(times) - segment, len(times)),
        }


@contextlib.contextmanager
def cluster(workers: int = 2) -> Iterator[str]:
    """Yield the address of a local Dask cluster whose workers have one thread each."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as local:
        yield local.scheduler_address


def file_contents(folder: Path) -> dict[str, bytes]:
    """Return the content of every file of a run, without times."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "timings.csv"
    }


def measure_kills(
    source: Path, kills: int, *options: str, command: Sequence[str] = RUN
) -> dict[str, int]:
    """Kill a command at random moments and resume it; count the results that differ."""
    with tempfile.TemporaryDirectory() as folder:
        complete, output = Path(folder, "whole"), Path(folder, "out")
        begin = time.monotonic()
        wait_for(start(str(source), "-o", str(complete), *options, command=command))
        seconds = time.monotonic() - begin
        expected, choice = file_contents(complete), random.Random(1)
        counts = {"killed": 0, "ended before": 0, "other bytes": 0}
        while counts["killed"] < kills:
            resume = ["--resume"] if output.exists() else []
            process = start(str(source), "-o", str(output), *options, *resume, command=command)
            try:
                process.communicate(timeout=choice.uniform(0.3, 0.9) * seconds)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.communicate()
                counts["killed"] += 1
                continue
            counts["ended before"] += 1
            counts["other bytes"] += file_contents(output) != expected
            shutil.rmtree(output)
        wait_for(start(str(source), "-o", str(output), *options, "--resume", command=command))
        counts["other bytes"] += file_contents(output) != expected
        return counts


def bars(results: Results) -> list[Bar]:
    result = []
    if results.workers:
        ratio = float(np.median([two / one for one, two in results.workers]))
        result.append(Bar("two workers over one", ratio, MIN_SPEEDUP, at_most=False))
    if results.frames:
        figures = results.frames
        memory = figures["memory at the end, MB"] / figures["memory early, MB"] - 1
        speed_loss = 1 - figures["pairs/s at the end"] / figures["pairs/s early"]
        result.append(Bar("growth of memory until the end, share", memory, MAX_CHANGE))
        result.append(Bar("loss of speed until the end, share", speed_loss, MAX_CHANGE))
    for name, counts in results.kills.items():
        result.append(Bar(f"{name}: other bytes after kills", counts["other bytes"], 0))
    return result


def report(results: Results, conditions: dict[str, Any]) -> str:
    tables = []
    if results.workers:
        head = ["round", "one worker, pairs/s", "two workers, pairs/s", "ratio"]
        rows = [
            [str(number), f"{one:.2f}", f"{two:.2f}", f"{two / one:.2f}"]
            for number, (one, two) in enumerate(results.workers, 1)
        ]
        tables.append(Table(head, rows, text_columns=0))
    if results.frames:
        cells = [f"{value:.4g}" for value in results.frames.values()]
        tables.append(Table(list(results.frames), [cells], text_columns=0))
    if results.kills:
        rows = [[name, *map(str, counts.values())] for name, counts in results.kills.items()]
        tables.append(Table(["killed", "times", "ended before", "other bytes"], rows))
    return markdown_page("# Long runs", conditions, *tables, list(map(str, bars(results))))


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write, and return 1 if a bar is missed."""
    parser = options_parser("sequences.long_runs", __doc__, "smoke", "output", output="long_runs")
    parser.add_argument("source", nargs="?", type=Path, help="of workers; default: rendered")
    parser.add_argument("--worker-rounds", type=int, default=ROUNDS, help="0 for none")
    parser.add_argument("--pairs", type=int, default=FRAMES, help="of the long run; 0 for none")
    parser.add_argument("--kills", type=int, default=KILLS, help="of each kind; 0 for none")
    options = parser.parse_args(arguments)
    rounds, frames, kills = options.worker_rounds, options.pairs, options.kills
    pairs, start_pairs = PAIRS, START_PAIRS
    if options.smoke:
        rounds, frames, kills, pairs, start_pairs = 1, 3 * EARLY_PAIRS, 1, 5, 2
    results = Results()
    with tempfile.TemporaryDirectory() as folder:
        size = FRAME_SIZE if options.smoke else (540, 960)
        Path(folder, "large").mkdir()
        source = options.source or render_frames(Path(folder, "large"), pairs, *size)
        if rounds:
            results.workers = measure_workers(source, rounds, start_pairs)
        if frames:
            results.frames = measure_frames(frames)
        if kills:
            Path(folder, "few").mkdir()
            source_of_kills = render_frames(Path(folder, "few"), 40, 96, 128)
            results.kills["a run"] = measure_kills(source_of_kills, kills)
            results.kills["a run of two workers"] = measure_kills(
                source_of_kills, kills, "--workers", "2"
            )
            with cluster() as address:
                name = "a run on a cluster of two workers"
                results.kills[name] = measure_kills(source_of_kills, kills, "--cluster", address)
            Path(folder, "film").mkdir()
            room = room_film(rounds_of(48), 96, 128, textured=True, samples=1)
            for number, frame in enumerate(room.frames):
                write_png(Path(folder, "film", f"{number:03d}.png"), frame)
            focal = ("--focal", str(room.camera.focal))
            results.kills["a reconstruction in chunks of two workers"] = measure_kills(
                Path(folder, "film"), kills, *focal, command=RECONSTRUCT
            )
    name = "rendered, 540 × 960 px" if options.source is None else options.source.name
    text = report(results, {"workers on": name, "preset": "fast", **machine()})
    print(text)
    if options.smoke:
        return 0
    write_results(RESULTS / options.output, text, asdict(results))
    return exit_code(bars(results))


if __name__ == "__main__":
    sys.exit(main())
