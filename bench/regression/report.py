"""What a comparison of two checkouts found, as Markdown, and what is out of bounds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.regression.compare import VISIBLE, Difference
from bench.regression.timing import Paired

MOST_SLOWER = 1.03  # time after over time before
ANSWER_HEAD = (
    "pair", "preset", "motion", "flow, px: largest", "median", f"over {VISIBLE:g} px",
    "1/Z, relative: largest", "median", "labels", "occlusion", "status",
)  # fmt: skip
TIME_HEAD = ("", "before, s", "after, s", "after / before", "the same, CPU time", "rounds")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One pair with one preset and one motion, and how the two answers to it differ.

    `difference` is None where a side gave none; the statuses say why.
    """

    pair: str
    preset: str
    motion: str
    before: str
    after: str
    difference: Difference | None

    @property
    def name(self) -> str:
        """Pair, preset and motion."""
        return f"{self.pair}, {self.preset}, {self.motion}"

    def cells(self) -> list[str]:
        """Return its line of the table."""
        status = self.before if self.before == self.after else f"{self.before} → {self.after}"
        found = self.difference
        if found is None:
            values = ["–"] * 7
        elif found.same:
            values = ["the same bits", *[""] * 6]
        else:
            values = [
                f"{found.flow_max:.2g}",
                f"{found.flow_median:.2g}",
                f"{found.visible:.3%}",
                f"{found.depth_max:.2g}",
                f"{found.depth_median:.2g}",
                f"{found.labels:.3%}",
                f"{found.occlusion:.3%}",
            ]
        return [self.pair, self.preset, self.motion, *values, status]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that one run found; `missing` is what was asked for → why there is none."""

    conditions: dict[str, Any]
    cases: Sequence[Case] = ()
    times: Sequence[Paired] = ()
    missing: dict[str, str] = field(default_factory=dict)


def out_of_bounds(found: Findings) -> Iterator[str]:
    """Yield what differs by more than rounding, and what is slower in wall and processor time."""
    for case in found.cases:
        if case.before != case.after:
            yield f"{case.name}: the status was {case.before} and is {case.after}"
        elif case.difference is not None and case.difference.visible > 0:
            share = f"{case.difference.visible:.3%}"
            yield f"{case.name}: flow differs by more than {VISIBLE:g} px at {share} of the pixels"
        elif case.difference is not None and case.difference.labels > 0:
            yield f"{case.name}: {case.difference.labels:.3%} of the labels differ"
    for paired in found.times:
        low, middle, _ = paired.ratios()
        # Where others use the machine, wall time alone tells little.
        if low > MOST_SLOWER and paired.ratios(cpu=True)[0] > MOST_SLOWER:
            yield f"{paired.name}: {middle:.3f} times as long, at least {low:.3f} in 3 rounds of 4"


def markdown(found: Findings) -> str:
    """Return the report."""
    lines = ["# Regression", ""]
    lines += [f"- {name}: {value}" for name, value in found.conditions.items()]
    lines += [f"- missing: {name}: {why}" for name, why in found.missing.items()]
    if found.cases:
        lines += ["", "## Answers", "", *_summary(found.cases), ""]
        lines += _table(ANSWER_HEAD, [case.cells() for case in found.cases], text=3)
    if found.times:
        lines += [
            "",
            "## Times",
            "",
            "Medians of the rounds. In each round both sides take their turn; ratios are of the "
            "same round, the median with the lower and upper quartile.",
            "",
            *_table(TIME_HEAD, [_time_cells(paired) for paired in found.times], text=1),
        ]
    lines += ["", "## Out of bounds", ""]
    lines += [f"- {line}" for line in out_of_bounds(found)] or ["Nothing."]
    return "\n".join(lines) + "\n"


def _summary(cases: Sequence[Case]) -> list[str]:
    compared = [case.difference for case in cases if case.difference is not None]
    lines = [
        f"{len(cases)} cases; in {sum(d.same for d in compared)} every array is the same in every "
        f"bit, in {sum(case.before != case.after for case in cases)} the status differs."
    ]
    if compared:
        lines[0] += (
            f" Largest difference of flow: {max(d.flow_max for d in compared):.2g} px; of inverse "
            f"depth, relative: {max(d.depth_max for d in compared):.2g}."
        )
    return lines


def _time_cells(paired: Paired) -> list[str]:
    def text(cpu: bool) -> str:
        low, middle, high = paired.ratios(cpu=cpu)
        return f"{middle:.3f} [{low:.3f}–{high:.3f}]"

    rounds = str(len(paired.seconds))
    return [paired.name, *map("{:.4g}".format, paired.medians), text(False), text(True), rounds]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], *, text: int) -> list[str]:
    """Return a table whose first columns, so many, are text."""
    rules = ["---"] * text + ["---:"] * (len(head) - text)
    return ["| " + " | ".join(row) + " |" for row in (head, rules, *rows)]
