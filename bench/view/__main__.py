"""``python -m bench.view``: the viewer on long results, in a real browser."""

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from bench.shared.command import options_parser
from bench.shared.results import RESULTS, Bar, Table, exit_code, machine, text_of, write
from bench.view.long_results import (
    lengthened_reconstruction,
    lengthened_run,
    write_frames,
    write_short,
)
from bench.view.opening import Opening, browser, opened

FRAMES = 1000  # of each result
SHORT = 8  # frames of the short results that are repeated
HEIGHT = 480  # px
WIDTH = 640  # px
ROUNDS = 5  # starts of the command on each result
STEPS = 6  # of the slider in each start


BAR = 3.0  # s until points are visible; set by hand
NAMES = {"run": "`tisfm run`", "reconstruction": "`tisfm reconstruct`"}
HEAD = (
    "", "frames", "page served, s", "points seen, s", "in the slowest start, s",
    "processor until then, s", "all points have come, s", "step of the slider, s",
    "its points have come, s", "memory, MB", "peak, MB",
)  # fmt: skip


def bars(found: Mapping[str, Sequence[Opening]]) -> list[Bar]:
    """Return the bar of each kind of result."""
    return [
        Bar(f"{NAMES[kind]}: s until points are seen", median(o.first for o in openings), BAR)
        for kind, openings in found.items()
    ]


def report(
    found: Mapping[str, Sequence[Opening]], frames: int, conditions: Mapping[str, Any]
) -> str:
    """Return the results as Markdown."""
    table = Table(HEAD, [_row(kind, openings, frames) for kind, openings in found.items()])
    notes = [
        *map(str, bars(found)),
        "Times start with `tisfm view`. The browser, a headless Chromium without a GPU, is already "
        "open and draws on the same cores as the command. Medians over starts, of steps over all "
        "of them. Steps go to frames that were not shown before. Memory is that of the command, "
        "after the first picture and at most.",
    ]
    return text_of("# The viewer on long results", conditions, table, notes)


def _row(kind: str, openings: Sequence[Opening], frames: int) -> list[str]:
    steps = [step for opening in openings for step in opening.steps]
    values = [
        median(o.served for o in openings),
        median(o.first for o in openings),
        max(o.first for o in openings),
        median(o.processor for o in openings),
        median(o.refined for o in openings),
        median(shown for shown, _ in steps),
        median(refined for _, refined in steps),
    ]
    sizes = [_size([o.memory for o in openings]), _size([o.peak for o in openings])]
    cells = [NAMES[kind], str(frames), *(f"{value:.2f}" for value in values), *sizes]
    return cells


def _size(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{median(known):.0f}" if known else "–"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write ``bench/results/view.md``, and return 1 if the bar is missed."""
    parser = options_parser("view", __doc__, "smoke", "output", output="view")
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each result")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="starts of the command on each")
    options = parser.parse_args(arguments)
    frames, rounds, steps, size = options.frames, options.rounds, STEPS, (HEIGHT, WIDTH)
    if options.smoke:
        frames, rounds, steps, size = 30, 1, 2, (240, 320)
    found: dict[str, list[Opening]] = {"run": [], "reconstruction": []}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        focal = write_frames(folder / "frames", SHORT, *size)
        write_short(folder / "frames", focal, folder / "short_run", folder / "short_reconstruction")
        lengthened_run(folder / "short_run", folder / "run", frames)
        lengthened_reconstruction(
            folder / "short_reconstruction", folder / "reconstruction", frames
        )
        try:
            with browser() as chromium:
                version = chromium.version
                for turn in range(rounds + (not options.smoke)):
                    for kind, openings in found.items():
                        first = 1 + turn * steps
                        visited = [
                            (k * frames // (steps + 1) + first) % frames for k in range(1, 7)
                        ]
                        opening = opened(chromium, folder / kind, visited[:steps])
                        if turn or options.smoke:  # else it reads cold files
                            openings.append(opening)
        except RuntimeError as error:
            print(f"bench.view: {error}", file=sys.stderr)
            return 1
    about = {"frames": f"{size[0]} × {size[1]} px", "Chromium": version, **machine()}
    text = report(found, frames, about)
    print(text)
    if options.smoke:
        return 0
    write(RESULTS / options.output, text)
    return exit_code(bars(found))


if __name__ == "__main__":
    raise SystemExit(main())
