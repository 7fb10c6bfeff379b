"""Measure the viewer on long results: ``python -m bench.view``."""

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from bench.shared.results import RESULTS, Bar, machine
from bench.view.long_results import (
    lengthened_reconstruction,
    lengthened_run,
    write_frames,
    write_short,
)
from bench.view.opening import Opening, browser, opened

FRAMES, SHORT = 1000, 8
HEIGHT, WIDTH = 480, 640
ROUNDS, STEPS = 5, 6


BAR = 3.0  # s until points are seen
NAMES = {"run": "`tisfm run`", "reconstruction": "`tisfm reconstruct`"}
_HEAD = (
    "| | frames | page served, s | points seen, s | in the slowest start, s |"
    " processor until then, s | all points have come, s | step of the slider, s |"
    " its points have come, s | memory, MB | peak, MB |"
)


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
    rows = [_row(kind, openings, frames) for kind, openings in found.items()]
    return "\n".join(
        [
            "# The viewer on long results",
            "",
            *(f"- {name}: {value}" for name, value in conditions.items()),
            "",
            _HEAD,
            "| --- |" + " ---: |" * (_HEAD.count("|") - 2),
            *rows,
            "",
            *(f"- {bar}" for bar in bars(found)),
            "- From the start of `tisfm view` on, with a browser that is already open: a headless "
            "Chromium without a GPU, so that it draws on the cores that the command runs on. "
            "Medians over starts, of steps over all of them. Steps go to frames that were not "
            "looked at before. Memory is that of the command, after the first picture and at most.",
            "",
        ]
    )


def _row(kind: str, openings: Sequence[Opening], frames: int) -> str:
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
    return f"| {' | '.join(cells)} |"


def _size(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{median(known):.0f}" if known else "–"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write ``bench/results/view.md``, and return 1 if the bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.view", description=__doc__)
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each result")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="starts of the command on each")
    parser.add_argument("--smoke", action="store_true", help="short and small, and no bar")
    parser.add_argument("--output", default="view", metavar="NAME")
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
                        if turn or options.smoke:  # the first one finds cold files
                            openings.append(opening)
        except RuntimeError as error:
            print(f"bench.view: {error}", file=sys.stderr)
            return 1
    about = {"frames": f"{size[0]} × {size[1]} px", "Chromium": version, **machine()}
    text = report(found, frames, about)
    print(text)
    if options.smoke:
        return 0
    (RESULTS / f"{options.output}.md").write_text(text, encoding="utf-8")
    return 0 if all(bar.met for bar in bars(found)) else 1


if __name__ == "__main__":
    raise SystemExit(main())
