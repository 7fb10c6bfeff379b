"""``python -m bench.sequences.long_runs``: long runs, shared runs, and runs that are killed.

Workers: a video on a Dask cluster here of one worker of one thread, and of two, in turns; the speed
is that between the pair after which each worker has begun and the last one, so that start-up does
not count. Frames: a
run over many small frames, whose resident memory and speed after a hundred pairs and at the end are
compared. Kills: a run, a run of two workers, a run on a Dask cluster of two workers here, and a
reconstruction in chunks by two workers, each killed by SIGKILL at random moments and gone on with;
what is left is compared with that of a command without interruption. The tables are left in
bench/results/long_runs.md.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.sequences.rendered_films import rounds as rounds_of
from bench.shared.results import RESULTS, Bar, machine
from bench.writing import rendered
from tisfm.formats import write_png
from tisfm.scenes import room_film, static_scene

FASTER, APART = 1.7, 0.05  # bars: of two workers; share by which memory and speed may differ
ROUNDS, PAIRS, FRAMES, KILLS = 3, 120, 10_000, 20
BEGUN = 12  # pairs, after which every worker has begun
EARLY, STRETCH = 100, 1000  # pairs
SMALL = (48, 64)
COMMAND = [sys.executable, "-c", "import sys; from tisfm.cli.command_line import main; "
           "sys.exit(main())"]  # fmt: skip
RUN = ("run", "--preset", "fast", "--no-figures")
RECONSTRUCT = ("reconstruct", "--preset", "fast", "--workers", "2", "--chunk", "16")


@dataclass
class Found:
    """What was measured; a part that was left out has nothing."""

    workers: list[tuple[float, float]] = field(default_factory=list)  # pairs/s of one and two
    frames: dict[str, float] = field(default_factory=dict)
    kills: dict[str, dict[str, int]] = field(default_factory=dict)


def start(*options: str, command: Sequence[str] = RUN) -> subprocess.Popen[bytes]:
    """Begin a run, or another command, in a process of its own."""
    call = [*COMMAND, *command, *options]
    return subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def end(process: subprocess.Popen[bytes]) -> None:
    """Wait for a run, which has to succeed."""
    _, said = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"a run ended with {process.returncode}: {said.decode()}")


def written(folder: Path) -> list[float]:
    """Return when the pairs of a run were finished, s, in order."""
    return sorted(path.stat().st_mtime for path in folder.glob("*.npz"))


def speed(times: Sequence[float], first: int, last: int) -> float:
    """Return pairs per second from the pair after the first so many to another."""
    return (last - first) / (times[last - 1] - times[first - 1])


def measure_workers(source: Path, rounds: int, begun: int) -> list[tuple[float, float]]:
    """Return pairs per second of one worker and of two, each of one thread, in every round."""
    found = []
    for _ in range(rounds):
        both = []
        for workers in (1, 2):
            with tempfile.TemporaryDirectory() as folder, cluster(workers) as address:
                end(start(str(source), "-o", folder, "--cluster", address, "--threads", "1"))
                times = written(Path(folder))
                both.append(speed(times, begun, len(times)))
        found.append((both[0], both[1]))
    return found


def many_frames(folder: Path, count: int) -> Path:
    """Make a folder of so many small frames, of a scene seen to and fro."""
    scene = static_scene("sideways", *SMALL)
    kinds = []
    for number, frame in enumerate((scene.frame0, scene.frame1)):
        kinds.append(folder / f"kind{number}.png")
        write_png(kinds[-1], np.clip(np.rint(frame), 0, 255).astype(np.uint8))
    place = folder / "frames"
    place.mkdir()
    for number in range(count):
        os.link(kinds[number % 2], place / f"frame{number:06d}.png")
    return place


def resident(process: subprocess.Popen[bytes]) -> float:
    """Return the resident memory of a process, MB; 0 if it has ended."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path(f"/proc/{process.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1e3
    return 0.0


def measure_frames(count: int) -> dict[str, float]:
    """Return memory and speed of a run over so many frames, early and at the end."""
    with tempfile.TemporaryDirectory() as folder:
        source, output = many_frames(Path(folder), count), Path(folder, "out")
        process = start(str(source), "-o", str(output), "--figures", "500")
        early, last = 0.0, 0.0
        while process.poll() is None:
            time.sleep(0.2)
            last = resident(process) or last
            if early == 0 and output.exists() and len(os.listdir(output)) > 4 * EARLY:
                early = last
        end(process)
        times = written(output)
        stretch = min(STRETCH, len(times) // 4)
        return {
            "pairs": len(times),
            "memory early, MB": early,
            "memory at the end, MB": last,
            "pairs/s early": speed(times, EARLY, EARLY + stretch),
            "pairs/s at the end": speed(times, len(times) - stretch, len(times)),
        }


@contextlib.contextmanager
def cluster(workers: int = 2) -> Iterator[str]:
    """Yield the address of a cluster of so many workers here, of one thread each."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as made:
        yield made.scheduler_address


def contents(folder: Path) -> dict[str, bytes]:
    """Return all that a run left, but for how long it took."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "timings.csv"
    }


def measure_kills(
    source: Path, kills: int, *options: str, command: Sequence[str] = RUN
) -> dict[str, int]:
    """Kill a command so many times at random moments, and go on; count what is wrong then."""
    with tempfile.TemporaryDirectory() as folder:
        whole, output = Path(folder, "whole"), Path(folder, "out")
        begin = time.monotonic()
        end(start(str(source), "-o", str(whole), *options, command=command))
        seconds = time.monotonic() - begin
        expected, choice = contents(whole), random.Random(1)
        counts = {"killed": 0, "ended before": 0, "other bytes": 0}
        while counts["killed"] < kills:
            again = ["--resume"] if output.exists() else []
            process = start(str(source), "-o", str(output), *options, *again, command=command)
            try:
                process.communicate(timeout=choice.uniform(0.3, 0.9) * seconds)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.communicate()
                counts["killed"] += 1
                continue
            counts["ended before"] += 1
            counts["other bytes"] += contents(output) != expected
            shutil.rmtree(output)
        end(start(str(source), "-o", str(output), *options, "--resume", command=command))
        counts["other bytes"] += contents(output) != expected
        return counts


def bars(found: Found) -> list[Bar]:
    """Return figures and their bars."""
    result = []
    if found.workers:
        ratio = float(np.median([two / one for one, two in found.workers]))
        result.append(Bar("two workers over one", ratio, FASTER, at_most=False))
    if found.frames:
        of = found.frames
        memory = of["memory at the end, MB"] / of["memory early, MB"] - 1
        slower = 1 - of["pairs/s at the end"] / of["pairs/s early"]
        result.append(Bar("share of memory more at the end", memory, APART))
        result.append(Bar("share of speed less at the end", slower, APART))
    for name, counts in found.kills.items():
        result.append(Bar(f"{name}: other bytes after kills", counts["other bytes"], 0))
    return result


def report(found: Found, conditions: dict[str, Any]) -> str:
    """Return the results as Markdown."""
    lines = ["# Long runs", "", *(f"- {name}: {value}" for name, value in conditions.items()), ""]
    if found.workers:
        lines += [
            "| round | one worker, pairs/s | two workers, pairs/s | ratio |",
            "|" + " ---: |" * 4,
        ]
        for number, (one, two) in enumerate(found.workers, 1):
            lines.append(f"| {number} | {one:.2f} | {two:.2f} | {two / one:.2f} |")
        lines.append("")
    if found.frames:
        lines += [f"| {' | '.join(found.frames)} |", "|" + " ---: |" * len(found.frames)]
        lines += [f"| {' | '.join(f'{value:.4g}' for value in found.frames.values())} |", ""]
    if found.kills:
        lines += ["| killed | times | ended before | other bytes |", "| --- |" + " ---: |" * 3]
        lines += [
            f"| {name} | {' | '.join(map(str, counts.values()))} |"
            for name, counts in found.kills.items()
        ]
        lines.append("")
    return "\n".join([*lines, *(f"- {bar}" for bar in bars(found)), ""])


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write, and return 1 if a bar is missed."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.sequences.long_runs", description=__doc__
    )
    parser.add_argument("source", nargs="?", type=Path, help="of workers; default: rendered")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="of workers; 0 for none")
    parser.add_argument("--frames", type=int, default=FRAMES, help="0 for none")
    parser.add_argument("--kills", type=int, default=KILLS, help="of each kind; 0 for none")
    parser.add_argument("--smoke", action="store_true", help="a little of each, and no bar")
    parser.add_argument("--output", default="long_runs", metavar="NAME")
    options = parser.parse_args(arguments)
    rounds, frames, kills, pairs, begun = (
        options.rounds,
        options.frames,
        options.kills,
        PAIRS,
        BEGUN,
    )
    if options.smoke:
        rounds, frames, kills, pairs, begun = 1, 3 * EARLY, 1, 5, 2
    found = Found()
    with tempfile.TemporaryDirectory() as folder:
        size = SMALL if options.smoke else (540, 960)
        Path(folder, "large").mkdir()
        source = options.source or rendered(Path(folder, "large"), pairs, *size)
        if rounds:
            found.workers = measure_workers(source, rounds, begun)
        if frames:
            found.frames = measure_frames(frames)
        if kills:
            Path(folder, "few").mkdir()
            few = rendered(Path(folder, "few"), 40, 96, 128)
            found.kills["a run"] = measure_kills(few, kills)
            found.kills["a run of two workers"] = measure_kills(few, kills, "--workers", "2")
            with cluster() as address:
                name = "a run on a cluster of two workers"
                found.kills[name] = measure_kills(few, kills, "--cluster", address)
            Path(folder, "film").mkdir()
            room = room_film(rounds_of(48), 96, 128, textured=True, samples=1)
            for number, frame in enumerate(room.frames):
                write_png(Path(folder, "film", f"{number:03d}.png"), frame)
            focal = ("--focal", str(room.camera.focal))
            found.kills["a reconstruction in chunks of two workers"] = measure_kills(
                Path(folder, "film"), kills, *focal, command=RECONSTRUCT
            )
    name = "rendered, 540 × 960 px" if options.source is None else options.source.name
    text = report(found, {"workers on": name, "preset": "fast", **machine()})
    print(text)
    if options.smoke:
        return 0
    (RESULTS / f"{options.output}.md").write_text(text, encoding="utf-8")
    about = {"workers": found.workers, "frames": found.frames, "kills": found.kills}
    (RESULTS / f"{options.output}.json").write_text(json.dumps(about) + "\n", encoding="utf-8")
    return 0 if all(bar.met for bar in bars(found)) else 1


if __name__ == "__main__":
    sys.exit(main())
