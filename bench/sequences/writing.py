"""What storing every result costs a sequence: ``python -m bench.writing``.

`tisfm run --no-figures` and a loop over `tisfm.interpret_sequence` take the same frames in turns,
in one process, so that both find their kernels compiled.
"""

import argparse
import contextlib
import io
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

import tisfm
from bench.shared.bar import Bar
from bench.shared.machine import RESULTS, machine
from tisfm import runtime
from tisfm.cli.command_line import main as tisfm_command
from tisfm.formats import write_png
from tisfm.scenes import static_scene
from tisfm.settings import Preset

BAR = 1.6  # times the loop
ROUNDS, PAIRS = 7, 30
HEIGHT, WIDTH = 540, 960
Times = Sequence[tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What was measured of one source.

    Attributes
    ----------
    source : str
    pairs : int
    times : sequence of (float, float)
        The loop and the command line, s, in every round.
    size : int
        Bytes that the command line left.
    """

    source: str
    pairs: int
    times: Times
    size: int

    @property
    def ratios(self) -> tuple[float, float, float]:
        """Lower quartile, median and upper quartile of command line over loop."""
        times = np.array(self.times)
        low, middle, high = np.quantile(times[:, 1] / times[:, 0], (0.25, 0.5, 0.75))
        return float(low), float(middle), float(high)


def rendered(folder: Path, pairs: int, height: int, width: int) -> Path:
    """Write the two frames of a rendered scene in turns, as PNG files."""
    scene = static_scene("sideways", height, width)
    frames = scene.frame0, scene.frame1
    for number in range(pairs + 1):
        frame = np.clip(np.rint(frames[number % 2]), 0, 255).astype(np.uint8)
        write_png(folder / f"frame{number:03d}.png", frame)
    return folder


def measure(source: Path, preset: Preset, rounds: int) -> Outcome:
    """Time the loop and the command line in turns."""
    settings = tisfm.Settings.preset(preset)
    pairs = 0

    def loop() -> None:
        nonlocal pairs
        pairs = sum(1 for _ in tisfm.interpret_sequence(source, settings=settings))

    with tempfile.TemporaryDirectory() as left:
        turn = 0

        def run() -> None:
            nonlocal turn
            turn += 1
            arguments = ["run", str(source), "-o", f"{left}/{turn}", "--preset", preset]
            with contextlib.redirect_stdout(io.StringIO()):
                code = tisfm_command([*arguments, "--no-figures"])
            if code != 0:
                raise RuntimeError(f"tisfm run ended with exit code {code}")

        loop()  # compiles
        times = [(_seconds(loop), _seconds(run)) for _ in range(rounds)]
        size = sum(file.stat().st_size for file in Path(left, str(turn)).rglob("*"))
    return Outcome(source=source.name, pairs=pairs, times=times, size=size)


def bars(outcome: Outcome) -> list[Bar]:
    """Return the bar of the ratio."""
    return [Bar("tisfm run --no-figures over interpret_sequence", outcome.ratios[1], BAR)]


def report(outcome: Outcome, conditions: dict[str, object]) -> str:
    """Return the results as Markdown."""
    low, middle, high = outcome.ratios
    loop, run = np.median(np.array(outcome.times), axis=0)
    return "\n".join(
        [
            "# What storing every result costs",
            "",
            *(f"- {name}: {value}" for name, value in conditions.items()),
            "",
            "| pairs | rounds | loop, s | `tisfm run --no-figures`, s | ratio | quartiles | MB "
            "written |",
            "| ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
            f"| {outcome.pairs} | {len(outcome.times)} | {loop:.2f} | {run:.2f} | {middle:.2f} | "
            f"{low:.2f}–{high:.2f} | {outcome.size / 1e6:.0f} |",
            "",
            *(f"- {bar}" for bar in bars(outcome)),
            "- loop: over `tisfm.interpret_sequence`, nothing stored. Medians, in turns; the "
            "quartiles are those of the ratio in a round.",
            "",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write ``bench/results/writing.md``, and return 1 if the bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.writing", description=__doc__)
    parser.add_argument("source", nargs="?", type=Path, help="video or folder; default: rendered")
    parser.add_argument("--preset", choices=get_args(Preset), default="fast")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--pairs", type=int, default=PAIRS, help="of the rendered frames")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--smoke", action="store_true", help="small frames, and no bar")
    parser.add_argument("--output", default="writing", metavar="NAME")
    options = parser.parse_args(arguments)
    runtime.start(threads=options.threads)
    pairs, rounds, size = options.pairs, options.rounds, (HEIGHT, WIDTH)
    if options.smoke:
        pairs, rounds, size = 3, 1, (96, 128)
    with tempfile.TemporaryDirectory() as folder:
        source = options.source or rendered(Path(folder), pairs, *size)
        outcome = measure(source, options.preset, rounds)
    kind = "rendered" if options.source is None else outcome.source
    text = report(outcome, {"source": kind, "preset": options.preset, **machine()})
    print(text)
    if options.smoke:
        return 0
    (RESULTS / f"{options.output}.md").write_text(text, encoding="utf-8")
    found = {"source": kind, "pairs": outcome.pairs, "times": outcome.times, "size": outcome.size}
    (RESULTS / f"{options.output}.json").write_text(json.dumps(found) + "\n", encoding="utf-8")
    return 0 if all(bar.met for bar in bars(outcome)) else 1


def _seconds(function: Callable[[], None]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start
