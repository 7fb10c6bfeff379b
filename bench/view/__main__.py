"""Measure the viewer on long results: ``python -m bench.view``."""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.shared.machine import RESULTS, machine
from bench.view.long_results import (
    lengthened_reconstruction,
    lengthened_run,
    write_frames,
    write_short,
)
from bench.view.opening import Opening, browser, opened
from bench.view.report import bars, report

FRAMES, SHORT = 1000, 8
HEIGHT, WIDTH = 480, 640
ROUNDS, STEPS = 5, 6


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
