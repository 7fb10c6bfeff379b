"""Figures of a contest: mean errors and times of its methods, and their tables."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Literal

from rich.console import Console

from bench.shared.contest import (
    FAST_CALL,
    MAX_SLOW_ROUNDS,
    SLOW_CALL,
    Contest,
    Measurement,
    PairInfo,
)
from bench.shared.results import (
    EMPTY_CELL,
    Table,
    cell,
    markdown_page,
    missing_sections,
    print_missing,
    write_results,
)

Metric = Literal["epe", "aae", "outliers"]
STANDARD_SIZE = (480, 640)  # px, height and width of the pairs with compared times
DETAIL_TITLES: tuple[tuple[Metric, str], ...] = (
    ("epe", "EPE, px"),
    ("aae", "AAE, degrees"),
    ("outliers", "Outliers, %"),
)


@dataclass(frozen=True)
class Column:
    """The mean of an error over a group of pairs."""

    title: str
    group: str
    metric: Metric

    def value(self, contest: Contest, method: str) -> float | None:
        """Return the mean, or None if the method failed on a pair of the group."""
        measurements = [contest.measurement(method, pair.name) for pair in self.pairs(contest)]
        values: list[float | None] = [
            getattr(measurement, self.metric) if measurement else None
            for measurement in measurements
        ]
        known_values = [value for value in values if value is not None]
        return fmean(known_values) if known_values and len(known_values) == len(values) else None

    def pairs(self, contest: Contest) -> list[PairInfo]:
        return [pair for pair in contest.pairs if pair.group == self.group]


COLUMNS = (
    Column("Middlebury EPE, px", "middlebury", "epe"),
    Column("Yosemite with clouds AAE, °", "yosemite_clouds", "aae"),
    Column("Yosemite AAE, °", "yosemite_cloudless", "aae"),
    Column("alley EPE, px", "sintel_alley", "epe"),
    Column("cave clean EPE, px", "sintel_cave, clean", "epe"),
    Column("cave final EPE, px", "sintel_cave, final", "epe"),
    Column("stereo outliers, %", "stereo", "outliers"),
    Column("KITTI outliers, %", "kitti", "outliers"),
    Column("scenes EPE, px", "scenes", "epe"),
    Column("scenes AAE, °", "scenes", "aae"),
)


def measured_columns(contest: Contest) -> list[Column]:
    """Return the columns whose groups have a pair in the contest."""
    return [column for column in COLUMNS if column.pairs(contest)]


@dataclass(frozen=True)
class Spread:
    """Median and extremes over the rounds."""

    median: float
    lowest: float
    highest: float

    @classmethod
    def of(cls, values: list[float]) -> "Spread | None":
        """Return the spread of the values, or None without values."""
        return cls(median(values), min(values), max(values)) if values else None


def timed_pairs(contest: Contest) -> list[PairInfo]:
    """Return the pairs of the standard size, or all pairs if there are none."""
    return [pair for pair in contest.pairs if pair.size == STANDARD_SIZE] or list(contest.pairs)


def standard_time(contest: Contest, method: str) -> Spread | None:
    return Spread.of(list(_by_round(contest, method).values()))


def relative_time(contest: Contest, method: str) -> Spread | None:
    """Return the time over the time of the reference in the same round."""
    times, reference_times = _by_round(contest, method), _by_round(contest, contest.reference)
    return Spread.of(
        [times[turn] / reference_times[turn] for turn in times if turn in reference_times]
    )


def busy_cores(contest: Contest, method: str) -> float | None:
    """Return the mean number of busy cores during the timed calls."""
    timings = [t for m in _timed_measurements(contest, method) for t in m.timings]
    wall = sum(timing.seconds for timing in timings)
    return sum(timing.cpu for timing in timings) / wall if wall else None


def _timed_measurements(contest: Contest, method: str) -> list[Measurement]:
    """Return the measurements of a method on the timed pairs; none if it failed on one."""
    measurements = [contest.measurement(method, pair.name) for pair in timed_pairs(contest)]
    measured = [m for m in measurements if m is not None and m.timings]
    return measured if len(measured) == len(measurements) else []


def _by_round(contest: Contest, method: str) -> dict[int, float]:
    """Return round → mean time of the timed pairs, each scaled to the standard size."""
    sizes = {pair.name: math.prod(pair.size) for pair in contest.pairs}
    rounds: dict[int, list[float]] = {}
    measured = _timed_measurements(contest, method)
    for measurement in measured:
        scale = math.prod(STANDARD_SIZE) / sizes[measurement.pair]
        for timing in measurement.timings:
            rounds.setdefault(timing.round, []).append(timing.seconds * scale)
    return {turn: fmean(times) for turn, times in rounds.items() if len(times) == len(measured)}


def summary(contest: Contest, *, changes: bool = False) -> Table:
    """Return a row for every method.

    With `changes`, each error is followed by its difference from the reference's, %.
    """
    columns = measured_columns(contest)
    height, width = STANDARD_SIZE
    head = [
        "method",
        *(column.title for column in columns),
        f"s per {width}×{height} pair [lowest–highest]",
        f"time / {contest.reference}",
        "cores busy",
    ]
    rows = [
        [
            method,
            *(_error(contest, column, method, changes) for column in columns),
            _spread(standard_time(contest, method)),
            _spread(relative_time(contest, method)),
            _text(busy_cores(contest, method), ".1f"),
        ]
        for method in contest.methods
    ]
    return Table(head, rows)


def details(contest: Contest) -> dict[str, Table]:
    """Return title → table of every method on every pair."""

    def table(cell_of: Callable[[Measurement | None], str]) -> Table:
        rows = [
            [method, *(cell_of(contest.measurement(method, pair.name)) for pair in contest.pairs)]
            for method in contest.methods
        ]
        return Table(["method", *(pair.name for pair in contest.pairs)], rows)

    tables = {
        title: table(lambda measured, metric=metric: _figure(metric, getattr(measured, metric)))  # type: ignore[misc]
        for metric, title in DETAIL_TITLES
    }
    return tables | {"Seconds, median": table(lambda m: _text(m.seconds if m else None, "#.3g"))}


def notes(contest: Contest) -> list[str]:
    groups: dict[str, list[str]] = {}
    for pair in contest.pairs:
        groups.setdefault(pair.group, []).append(pair.name)
    timed = ", ".join(pair.name for pair in timed_pairs(contest))
    height, width = STANDARD_SIZE
    is_scaled = any(pair.size != STANDARD_SIZE for pair in timed_pairs(contest))
    basis = f"scaled by the number of pixels from {timed}" if is_scaled else f"mean of {timed}"
    return [
        "Errors are means over the pixels with known truth, then over the pairs of a group: "
        + "; ".join(f"{group}: {', '.join(names)}" for group, names in groups.items())
        + ". An outlier is off by at least 3 px and 5% of the true displacement.",
        *(f"{pair.name}: {pair.note}." for pair in contest.pairs if pair.note),
        f"Seconds per {width}×{height} pair: {basis}; median over the rounds, in brackets the "
        "lowest and the highest. In every round each method runs once, one after the other; ratios "
        "are taken within a round. The first call of each method on each pair is not timed; a call "
        f"of less than {FAST_CALL:g} s runs once more, untimed, before each timed call. Methods of "
        f"more than {SLOW_CALL:g} s have no untimed calls and at most {MAX_SLOW_ROUNDS} rounds.",
        "Cores busy: processor time over wall time.",
    ]


def show(contest: Contest, console: Console, *, changes: bool = False) -> None:
    console.print(summary(contest, changes=changes).rich())
    print_missing(console, contest.missing, contest.failures())


def write(
    contest: Contest, path: Path, *, title: str, remarks: Sequence[str] = (), changes: bool = False
) -> None:
    sections = [
        block for heading, table in details(contest).items() for block in (f"## {heading}", table)
    ]
    text = markdown_page(
        f"# {title}",
        contest.conditions,
        summary(contest, changes=changes),
        [*remarks, *notes(contest)],
        *missing_sections(contest.missing, contest.failures()),
        *sections,
    )
    write_results(path, text, contest.as_json())


def _error(contest: Contest, column: Column, method: str, changes: bool) -> str:
    value = column.value(contest, method)
    text = _figure(column.metric, value)
    reference_times = column.value(contest, contest.reference) if changes else None
    if value is None or not reference_times or method == contest.reference:
        return text
    return f"{text} ({value / reference_times - 1:+.1%})"


def _figure(metric: Metric, value: float | None) -> str:
    if value is None:
        return EMPTY_CELL
    return {"epe": f"{value:.3f}", "aae": f"{value:.2f}", "outliers": f"{100 * value:.1f}"}[metric]


def _spread(spread: Spread | None) -> str:
    if spread is None:
        return EMPTY_CELL
    low, middle, high = (
        f"{v:#.3g}".rstrip(".") for v in (spread.lowest, spread.median, spread.highest)
    )
    return middle if low == high else f"{middle} [{low}–{high}]"


def _text(value: float | None, form: str) -> str:
    return cell(value, form).rstrip(".")
