"""Figures of a contest: mean errors of groups of pairs, and the time of a standard pair."""

import math
from dataclasses import dataclass
from statistics import fmean, median
from typing import Literal

from bench.shared.contest import Contest, Measurement, PairInfo

Metric = Literal["epe", "aae", "outliers"]
STANDARD_SIZE = (480, 640)  # px, height and width of the pairs with compared times


@dataclass(frozen=True)
class Column:
    """The mean of an error over a group of pairs."""

    title: str
    group: str
    metric: Metric

    def value(self, contest: Contest, method: str) -> float | None:
        """Return the mean, or None if the method failed on a pair of the group."""
        found = [contest.of(method, pair.name) for pair in self.pairs(contest)]
        values: list[float | None] = [
            getattr(measurement, self.metric) if measurement else None for measurement in found
        ]
        known = [value for value in values if value is not None]
        return fmean(known) if known and len(known) == len(values) else None

    def pairs(self, contest: Contest) -> list[PairInfo]:
        """Return the pairs of the group that were measured."""
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


def present(contest: Contest) -> list[Column]:
    """Return the columns whose groups have a pair in the contest."""
    return [column for column in COLUMNS if column.pairs(contest)]


@dataclass(frozen=True)
class Spread:
    """Median and extremes over the rounds."""

    median: float
    least: float
    most: float

    @classmethod
    def of(cls, values: list[float]) -> "Spread | None":
        """Return the spread of the values, or None without values."""
        return cls(median(values), min(values), max(values)) if values else None


def timed_pairs(contest: Contest) -> list[PairInfo]:
    """Return the pairs of the standard size, or all pairs if there are none."""
    return [pair for pair in contest.pairs if pair.size == STANDARD_SIZE] or list(contest.pairs)


def standard_time(contest: Contest, method: str) -> Spread | None:
    """Return the time of a standard pair, s."""
    return Spread.of(list(_by_round(contest, method).values()))


def ratio(contest: Contest, method: str) -> Spread | None:
    """Return the time as a multiple of that of the reference in the same round."""
    own, unit = _by_round(contest, method), _by_round(contest, contest.reference)
    return Spread.of([own[turn] / unit[turn] for turn in own if turn in unit])


def cores(contest: Contest, method: str) -> float | None:
    """Return the mean number of busy cores during the timed calls."""
    timings = [t for m in _measured(contest, method) for t in m.timings]
    wall = sum(timing.seconds for timing in timings)
    return sum(timing.cpu for timing in timings) / wall if wall else None


def _measured(contest: Contest, method: str) -> list[Measurement]:
    """Return the measurements of a method on the timed pairs; none if it failed on one."""
    found = [contest.of(method, pair.name) for pair in timed_pairs(contest)]
    measured = [m for m in found if m is not None and m.timings]
    return measured if len(measured) == len(found) else []


def _by_round(contest: Contest, method: str) -> dict[int, float]:
    """Return round → mean time of the timed pairs, each scaled to the standard size."""
    sizes = {pair.name: math.prod(pair.size) for pair in contest.pairs}
    rounds: dict[int, list[float]] = {}
    measured = _measured(contest, method)
    for measurement in measured:
        scale = math.prod(STANDARD_SIZE) / sizes[measurement.pair]
        for timing in measurement.timings:
            rounds.setdefault(timing.round, []).append(timing.seconds * scale)
    return {turn: fmean(times) for turn, times in rounds.items() if len(times) == len(measured)}
