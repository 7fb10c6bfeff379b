"""A contest as tables: one that sums it up, and one for each figure with every pair."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.shared.columns import (
    STANDARD_SIZE,
    Column,
    Metric,
    Spread,
    cores,
    present,
    ratio,
    standard_time,
    timed_pairs,
)
from bench.shared.contest import QUICK, SLOW, SLOW_ROUNDS, Contest

NOTHING = "–"
DETAILS: tuple[tuple[Metric, str], ...] = (
    ("epe", "EPE, px"),
    ("aae", "AAE, degrees"),
    ("outliers", "Outliers, %"),
)


@dataclass(frozen=True)
class Cells:
    """A table as text; the first column is the method's."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> list[str]:
        """Return the lines of a Markdown table."""
        rules = ["---"] + ["---:"] * (len(self.head) - 1)
        return ["| " + " | ".join(row) + " |" for row in (self.head, rules, *self.rows)]

    def rich(self) -> Table:
        """Return the table for a terminal."""
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for index, name in enumerate(self.head):
            table.add_column(escape(name), justify="right" if index else "left", no_wrap=index == 0)
        for row in self.rows:
            table.add_row(*map(escape, row))
        return table


def summary(contest: Contest, *, changes: bool = False) -> Cells:
    """Return a row for every method.

    Parameters
    ----------
    contest : Contest
    changes : bool
        Whether errors are followed by how they differ from the reference's, in percent.
    """
    columns = present(contest)
    height, width = STANDARD_SIZE
    head = [
        "method",
        *(column.title for column in columns),
        f"s per {width}×{height} pair [least–most]",
        f"time / {contest.reference}",
        "cores busy",
    ]
    rows = [
        [
            method,
            *(_error(contest, column, method, changes) for column in columns),
            _spread(standard_time(contest, method)),
            _spread(ratio(contest, method)),
            _text(cores(contest, method), ".1f"),
        ]
        for method in contest.methods
    ]
    return Cells(head, rows)


def details(contest: Contest) -> dict[str, Cells]:
    """Return title → table of every method on every pair."""
    head = ["method", *(pair.name for pair in contest.pairs)]
    tables = {
        title: Cells(
            head,
            [
                [
                    method,
                    *(
                        _figure(metric, getattr(contest.of(method, pair.name), metric))
                        for pair in contest.pairs
                    ),
                ]
                for method in contest.methods
            ],
        )
        for metric, title in DETAILS
    }
    seconds = [
        [
            method,
            *(
                _text(measured.seconds if measured else None, "#.3g")
                for measured in (contest.of(method, pair.name) for pair in contest.pairs)
            ),
        ]
        for method in contest.methods
    ]
    return tables | {"Seconds, median": Cells(head, seconds)}


def notes(contest: Contest) -> list[str]:
    """Return what a reader of the tables has to know."""
    groups: dict[str, list[str]] = {}
    for pair in contest.pairs:
        groups.setdefault(pair.group, []).append(pair.name)
    timed = ", ".join(pair.name for pair in timed_pairs(contest))
    height, width = STANDARD_SIZE
    scaled = any(pair.size != STANDARD_SIZE for pair in timed_pairs(contest))
    basis = f"scaled by the number of pixels from {timed}" if scaled else f"mean of {timed}"
    return [
        "Errors are means over pixels whose truth is known, then over the pairs of a group: "
        + "; ".join(f"{group}: {', '.join(names)}" for group, names in groups.items())
        + ". An outlier is off by at least 3 px and 5% of the true displacement.",
        *(f"{pair.name}: {pair.note}." for pair in contest.pairs if pair.note),
        f"Seconds per {width}×{height} pair: {basis}; median over the rounds, in brackets the "
        "least and the most. In every round each method runs once, one after the other; ratios "
        "are taken within a round. The first call of each method on each pair is not timed, nor is "
        f"a further one before each timed call of less than {QUICK:g} s; methods of more than "
        f"{SLOW:g} s have no such calls and at most {SLOW_ROUNDS} rounds.",
        "Cores busy: processor time over wall time.",
    ]


def show(contest: Contest, console: Console, *, changes: bool = False) -> None:
    """Print the summary, and what is missing or failed."""
    console.print(summary(contest, changes=changes).rich())
    for title, entries in (("missing", contest.missing), ("FAILED", contest.failures())):
        for name, reason in entries.items():
            console.print(f"{title}: {name}: {reason}", highlight=False, markup=False)


def write(
    contest: Contest,
    path: Path,
    *,
    title: str,
    remarks: Sequence[str] = (),
    changes: bool = False,
) -> None:
    """Write PATH.md and PATH.json."""
    lines = [f"# {title}", ""]
    lines += [f"- {name}: {value}" for name, value in contest.conditions.items()]
    lines += ["", *summary(contest, changes=changes).markdown(), ""]
    lines += [f"- {note}" for note in (*remarks, *notes(contest))]
    for heading, entries in (("Missing", contest.missing), ("Failed", contest.failures())):
        if entries:
            lines += ["", f"## {heading}", ""]
            lines += [f"- {name}: {reason}" for name, reason in entries.items()]
    for heading, table in details(contest).items():
        lines += ["", f"## {heading}", "", *table.markdown()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".md").write_text("\n".join([*lines, ""]), encoding="utf-8")
    content = json.dumps(contest.as_json(), indent=1, ensure_ascii=False)
    path.with_suffix(".json").write_text(content + "\n", encoding="utf-8")


def _error(contest: Contest, column: Column, method: str, changes: bool) -> str:
    value = column.value(contest, method)
    text = _figure(column.metric, value)
    unit = column.value(contest, contest.reference) if changes else None
    if value is None or not unit or method == contest.reference:
        return text
    return f"{text} ({value / unit - 1:+.1%})"


def _figure(metric: Metric, value: float | None) -> str:
    if value is None:
        return NOTHING
    return {"epe": f"{value:.3f}", "aae": f"{value:.2f}", "outliers": f"{100 * value:.1f}"}[metric]


def _spread(spread: Spread | None) -> str:
    if spread is None:
        return NOTHING
    low, middle, high = (
        f"{v:#.3g}".rstrip(".") for v in (spread.least, spread.median, spread.most)
    )
    return middle if low == high else f"{middle} [{low}–{high}]"


def _text(value: float | None, form: str) -> str:
    return NOTHING if value is None else format(value, form).rstrip(".")
