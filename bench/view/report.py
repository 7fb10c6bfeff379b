"""What came of looking at long results, as a table with its bar."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from bench.shared.bar import Bar
from bench.view.opening import Opening

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
