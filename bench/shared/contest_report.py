"""Tables of a contest: a summary, and for each figure a table of every pair."""

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

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
from bench.shared.contest import QUICK, SLOW, SLOW_ROUNDS, Contest, Measurement
from bench.shared.results import EMPTY, Table, cell, gaps, print_gaps, text_of
from bench.shared.results import write as write_files

DETAILS: tuple[tuple[Metric, str], ...] = (
    ("epe", "EPE, px"),
    ("aae", "AAE, degrees"),
    ("outliers", "Outliers, %"),
)


def summary(contest: Contest, *, changes: bool = False) -> Table:
    """Return a row for every method.

    Parameters
    ----------
    contest : Contest
    changes : bool
        Whether each error is followed by its difference from the reference's, in percent.
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
    return Table(head, rows)


def details(contest: Contest) -> dict[str, Table]:
    """Return title → table of every method on every pair."""

    def table(cell_of: Callable[[Measurement | None], str]) -> Table:
        rows = [
            [method, *(cell_of(contest.of(method, pair.name)) for pair in contest.pairs)]
            for method in contest.methods
        ]
        return Table(["method", *(pair.name for pair in contest.pairs)], rows)

    tables = {
        title: table(lambda measured, metric=metric: _figure(metric, getattr(measured, metric)))  # type: ignore[misc]
        for metric, title in DETAILS
    }
    return tables | {
        "Seconds, median": table(lambda m: _text(m.seconds if m else None, "#.3g")),
    }


def notes(contest: Contest) -> list[str]:
    """Return the notes on the tables."""
    groups: dict[str, list[str]] = {}
    for pair in contest.pairs:
        groups.setdefault(pair.group, []).append(pair.name)
    timed = ", ".join(pair.name for pair in timed_pairs(contest))
    height, width = STANDARD_SIZE
    scaled = any(pair.size != STANDARD_SIZE for pair in timed_pairs(contest))
    basis = f"scaled by the number of pixels from {timed}" if scaled else f"mean of {timed}"
    return [
        "Errors are means over the pixels with known truth, then over the pairs of a group: "
        + "; ".join(f"{group}: {', '.join(names)}" for group, names in groups.items())
        + ". An outlier is off by at least 3 px and 5% of the true displacement.",
        *(f"{pair.name}: {pair.note}." for pair in contest.pairs if pair.note),
        f"Seconds per {width}×{height} pair: {basis}; median over the rounds, in brackets the "
        "least and the most. In every round each method runs once, one after the other; ratios "
        "are taken within a round. The first call of each method on each pair is not timed; a call "
        f"of less than {QUICK:g} s runs once more, untimed, before each timed call. Methods of "
        f"more than {SLOW:g} s have no untimed calls and at most {SLOW_ROUNDS} rounds.",
        "Cores busy: processor time over wall time.",
    ]


def show(contest: Contest, console: Console, *, changes: bool = False) -> None:
    """Print the summary, and the missing and failed methods."""
    console.print(summary(contest, changes=changes).rich())
    print_gaps(console, contest.missing, contest.failures())


def write(
    contest: Contest,
    path: Path,
    *,
    title: str,
    remarks: Sequence[str] = (),
    changes: bool = False,
) -> None:
    """Write PATH.md and PATH.json."""
    sections = [
        block for heading, table in details(contest).items() for block in (f"## {heading}", table)
    ]
    text = text_of(
        f"# {title}",
        contest.conditions,
        summary(contest, changes=changes),
        [*remarks, *notes(contest)],
        *gaps(contest.missing, contest.failures()),
        *sections,
    )
    write_files(path, text, contest.as_json())


def _error(contest: Contest, column: Column, method: str, changes: bool) -> str:
    value = column.value(contest, method)
    text = _figure(column.metric, value)
    unit = column.value(contest, contest.reference) if changes else None
    if value is None or not unit or method == contest.reference:
        return text
    return f"{text} ({value / unit - 1:+.1%})"


def _figure(metric: Metric, value: float | None) -> str:
    if value is None:
        return EMPTY
    return {"epe": f"{value:.3f}", "aae": f"{value:.2f}", "outliers": f"{100 * value:.1f}"}[metric]


def _spread(spread: Spread | None) -> str:
    if spread is None:
        return EMPTY
    low, middle, high = (
        f"{v:#.3g}".rstrip(".") for v in (spread.least, spread.median, spread.most)
    )
    return middle if low == high else f"{middle} [{low}–{high}]"


def _text(value: float | None, form: str) -> str:
    return cell(value, form).rstrip(".")
