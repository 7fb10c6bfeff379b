"""``python -m bench.writing``: cost of storing every result of a sequence.

A loop over `tisfm.interpret_sequence`, `tisfm run --no-figures`, and `tisfm run` with a figure of
every tenth pair process the same frames in turns. They run in one process, so that kernels are
compiled before.
"""

import contextlib
import io
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import get_args

import numpy as np

import tisfm
from bench.shared.command import options_parser
from bench.shared.contest import measure_time
from bench.shared.results import (
    RESULTS,
    Bar,
    Table,
    exit_code,
    machine,
    markdown_page,
    write_results,
)
from tisfm import runtime
from tisfm.cli.command_line import main as tisfm_command
from tisfm.formats import write_png
from tisfm.scenes import static_scene
from tisfm.settings import Preset

# Bounds of the time over the loop's: without figures, and with every tenth figure; set by hand.
MAX_RATIOS = 1.3, 1.5
FIGURE_OPTIONS = ("--no-figures",), ("--figures", "10")
NAMES = "`tisfm run --no-figures`", "`tisfm run --figures 10`"
ROUNDS = 7  # timed rounds
PAIRS = 30  # of the rendered frames
HEIGHT = 540  # px
WIDTH = 960  # px
HEAD = ("", "pairs", "rounds", "loop, s", "run, s", "ratio", "quartiles")
Times = Sequence[tuple[float, float, float]]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    source: str
    pairs: int
    # s in every round: loop, command without figures, command with every tenth figure.
    times: Times
    size: int  # bytes that the command wrote without figures

    def ratios(self, kind: int) -> tuple[float, float, float]:
        """Lower quartile, median and upper quartile of the time of a command over the loop."""
        times = np.array(self.times)
        low, middle, high = np.quantile(times[:, 1 + kind] / times[:, 0], (0.25, 0.5, 0.75))
        return float(low), float(middle), float(high)


def render_frames(folder: Path, pairs: int, height: int, width: int) -> Path:
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

    with tempfile.TemporaryDirectory() as output:
        turn = 0

        def run(kind: int) -> None:
            nonlocal turn
            turn += 1
            arguments = ["run", str(source), "-o", f"{output}/{turn}", "--preset", preset]
            with contextlib.redirect_stdout(io.StringIO()):
                code = tisfm_command([*arguments, *FIGURE_OPTIONS[kind]])
            if code != 0:
                raise RuntimeError(f"tisfm run ended with exit code {code}")

        loop()  # compiles kernels
        times = []
        for _ in range(rounds):
            seconds = [measure_time(loop)[1], *(measure_time(run, kind)[1] for kind in (0, 1))]
            times.append((seconds[0], seconds[1], seconds[2]))
            shutil.rmtree(f"{output}/{turn}")  # a long video fills a disk
            if len(times) < rounds:
                shutil.rmtree(f"{output}/{turn - 1}")
        size = sum(file.stat().st_size for file in Path(output, str(turn - 1)).rglob("*"))
    return Outcome(source=source.name, pairs=pairs, times=times, size=size)


def bars(outcome: Outcome) -> list[Bar]:
    return [
        Bar(f"{name} over interpret_sequence", outcome.ratios(kind)[1], bar)
        for kind, (name, bar) in enumerate(zip(NAMES, MAX_RATIOS, strict=True))
    ]


def report(outcome: Outcome, conditions: dict[str, object]) -> str:
    loop, *runs = np.median(np.array(outcome.times), axis=0)
    rows = []
    for kind, seconds in enumerate(runs):
        low, middle, high = outcome.ratios(kind)
        rows.append(
            [
                NAMES[kind], str(outcome.pairs), str(len(outcome.times)), f"{loop:.2f}",
                f"{seconds:.2f}", f"{middle:.2f}", f"{low:.2f}–{high:.2f}",
            ]
        )  # fmt: skip
    notes = [
        *map(str, bars(outcome)),
        "loop: over `tisfm.interpret_sequence`, without storing anything. Medians, in turns; the "
        "quartiles are of the ratio in a round.",
    ]
    size = f"{outcome.size / 1e6:.0f} MB were written without figures."
    return markdown_page(
        "# Cost of storing every result", conditions, Table(HEAD, rows), size, notes
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write ``bench/results/writing.md``, and return 1 if a bar is missed."""
    parser = options_parser(
        "writing", __doc__, "rounds", "threads", "smoke", "output", rounds=ROUNDS, output="writing"
    )
    parser.add_argument("source", nargs="?", type=Path, help="video or folder; default: rendered")
    parser.add_argument("--preset", choices=get_args(Preset), default="fast")
    parser.add_argument("--pairs", type=int, default=PAIRS, help="of the rendered frames")
    options = parser.parse_args(arguments)
    runtime.start(threads=options.threads)
    pairs, rounds, size = options.pairs, options.rounds, (HEIGHT, WIDTH)
    if options.smoke:
        pairs, rounds, size = 3, 1, (96, 128)
    with tempfile.TemporaryDirectory() as folder:
        source = options.source or render_frames(Path(folder), pairs, *size)
        outcome = measure(source, options.preset, rounds)
    kind = "rendered" if options.source is None else outcome.source
    text = report(outcome, {"source": kind, "preset": options.preset, **machine()})
    print(text)
    if options.smoke:
        return 0
    write_results(RESULTS / options.output, text, asdict(outcome) | {"source": kind})
    return exit_code(bars(outcome))


if __name__ == "__main__":
    sys.exit(main())
