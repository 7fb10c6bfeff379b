"""Differences between the results and times of two checkouts, as Markdown, and their bounds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.regression.checkout import PairedTimes
from bench.shared.results import EMPTY_CELL, Table, markdown_page

MAX_ROUNDING = 1e-3  # px: a larger difference of flow is not only rounding
MIN_RELATIVE_DEPTH = 0.01  # smallest denominator of differences, over the median inverse depth


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of the results of two checkouts for one case."""

    flow_max: float  # of the absolute differences of u and v, px/frame
    flow_median: float
    above_rounding: float  # share of the pixels whose flow differs by more than `MAX_ROUNDING`
    depth_max: float  # of the differences of inverse depth, relative to its value before
    depth_median: float
    labels: float  # share of the pixels that differ
    occlusion: float  # share of the pixels that differ
    identical: bool  # whether every array is equal in every bit


def difference(before: Path, after: Path) -> Difference:
    """Return the difference of two stored results."""
    with np.load(before) as first, np.load(after) as second:
        old, new = dict(first), dict(second)
    flow = _absolute_difference(old["flow"], new["flow"]).max(axis=-1)
    depth = relative(old["inverse_depth"], new["inverse_depth"])
    return Difference(
        flow_max=float(flow.max()),
        flow_median=float(np.median(flow)),
        above_rounding=float((flow > MAX_ROUNDING).mean()),
        depth_max=float(depth.max()),
        depth_median=float(np.median(depth)),
        labels=_share(old.get("labels"), new.get("labels")),
        occlusion=_share(old["occlusion"], new["occlusion"]),
        identical=old.keys() == new.keys()
        and all(np.array_equal(old[k], new[k], equal_nan=old[k].dtype.kind == "f") for k in old),
    )


def relative(before: NDArray, after: NDArray) -> NDArray:
    """Return |after − before| / |before|; small |before| are raised to `MIN_RELATIVE_DEPTH`."""
    difference = _absolute_difference(before, after)
    finite_values = np.abs(before[np.isfinite(before)])
    floor = MIN_RELATIVE_DEPTH * float(np.median(finite_values)) if finite_values.size else 0.0
    unit = np.maximum(np.abs(before), floor)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(difference > 0, difference / np.where(np.isfinite(unit), unit, 1.0), 0.0)


def _absolute_difference(before: NDArray, after: NDArray) -> NDArray:
    """Return |after − before|: 0 where both are equal or NaN, and inf where only one is finite."""
    old, new = np.asarray(before, np.float64), np.asarray(after, np.float64)
    equal = (old == new) | (np.isnan(old) & np.isnan(new))
    with np.errstate(invalid="ignore"):
        gap = np.abs(new - old)
    return np.where(equal, 0.0, np.where(np.isfinite(gap), gap, np.inf))


def _share(before: NDArray | None, after: NDArray | None) -> float:
    """Return the share of unequal entries; 1 if only one checkout has the array."""
    if before is None or after is None:
        return 0.0 if before is after else 1.0
    return float((before != after).mean())


MAX_SLOWDOWN = 1.03  # time after over time before, at most; set by hand
ANSWER_HEAD = (
    "pair", "preset", "motion", "flow, px: largest", "median", f"over {MAX_ROUNDING:g} px",
    "1/Z, relative: largest", "median", "labels", "occlusion", "status",
)  # fmt: skip
TIME_HEAD = ("", "before, s", "after, s", "after / before", "the same, CPU time", "rounds")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One pair with one preset and one motion, and the difference of its two results.

    `difference` is None if a checkout gave no result; the status has the reason.
    """

    pair: str
    preset: str
    motion: str
    before: str
    after: str
    difference: Difference | None

    @property
    def name(self) -> str:
        return f"{self.pair}, {self.preset}, {self.motion}"

    def cells(self) -> list[str]:
        status = self.before if self.before == self.after else f"{self.before} → {self.after}"
        difference = self.difference
        if difference is None:
            values = [EMPTY_CELL] * 7
        elif difference.identical:
            values = ["the same bits", *[""] * 6]
        else:
            values = [
                f"{difference.flow_max:.2g}",
                f"{difference.flow_median:.2g}",
                f"{difference.above_rounding:.3%}",
                f"{difference.depth_max:.2g}",
                f"{difference.depth_median:.2g}",
                f"{difference.labels:.3%}",
                f"{difference.occlusion:.3%}",
            ]
        return [self.pair, self.preset, self.motion, *values, status]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All figures of one run; `missing` is name → reason."""

    conditions: dict[str, Any]
    cases: Sequence[Case] = ()
    times: Sequence[PairedTimes] = ()
    missing: dict[str, str] = field(default_factory=dict)


def out_of_bounds(findings: Findings) -> Iterator[str]:
    """Yield results that differ by more than rounding, and calls that are slower."""
    for case in findings.cases:
        if case.before != case.after:
            yield f"{case.name}: the status was {case.before} and is {case.after}"
        elif (difference := case.difference) is not None and difference.above_rounding > 0:
            share = f"{difference.above_rounding:.3%} of the pixels"
            yield f"{case.name}: flow differs by more than {MAX_ROUNDING:g} px at {share}"
        elif difference is not None and difference.labels > 0:
            yield f"{case.name}: {difference.labels:.3%} of the labels differ"
    for paired in findings.times:
        low, middle, _ = paired.ratios()
        # On a busy machine, wall time alone proves nothing.
        if low > MAX_SLOWDOWN and paired.ratios(cpu=True)[0] > MAX_SLOWDOWN:
            yield f"{paired.name}: {middle:.3f} times as long, at least {low:.3f} in 3 rounds of 4"


def markdown(findings: Findings) -> str:
    blocks: list[str | Table | list[str]] = []
    if findings.cases:
        table = Table(ANSWER_HEAD, [case.cells() for case in findings.cases], text_columns=3)
        blocks += ["## Answers", _summary(findings.cases), table]
    if findings.times:
        note = (
            "Medians of the rounds. In each round both checkouts take their turn; ratios are of "
            "the same round, the median with the lower and upper quartile."
        )
        blocks += ["## Times", note, Table(TIME_HEAD, [_time_cells(p) for p in findings.times])]
    blocks += ["## Out of bounds", list(out_of_bounds(findings)) or "Nothing."]
    missing = {f"missing: {name}": reason for name, reason in findings.missing.items()}
    return markdown_page("# Regression", findings.conditions | missing, *blocks)


def _summary(cases: Sequence[Case]) -> str:
    compared = [case.difference for case in cases if case.difference is not None]
    text = (
        f"{len(cases)} cases; in {sum(d.identical for d in compared)} every array is the same in "
        f"every bit, in {sum(case.before != case.after for case in cases)} the status differs."
    )
    if compared:
        text += (
            f" Largest difference of flow: {max(d.flow_max for d in compared):.2g} px; of inverse "
            f"depth, relative: {max(d.depth_max for d in compared):.2g}."
        )
    return text


def _time_cells(paired: PairedTimes) -> list[str]:
    def text(cpu: bool) -> str:
        low, middle, high = paired.ratios(cpu=cpu)
        return f"{middle:.3f} [{low:.3f}–{high:.3f}]"

    rounds = str(len(paired.seconds))
    return [paired.name, *map("{:.4g}".format, paired.medians), text(False), text(True), rounds]
