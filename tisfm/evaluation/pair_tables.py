"""The tables that `tisfm eval` prints."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from rich.table import Table
from rich.text import Text

from tisfm.evaluation.pair_errors import ErrorSummary, MeanErrors, mean_errors
from tisfm.evaluation.pairs import Evaluation, PairEvaluation
from tisfm.metrics import DepthErrors, OcclusionScores, PoseErrors

_EMPTY_CELL = "–"  # cell without a value
_Row = PairEvaluation | MeanErrors

# Headings and cells. Some columns exist only if a pair has such an error.
_FLOW_COLUMNS: dict[str, Callable[[_Row], str]] = {
    "EPE, px": lambda row: f"{row.errors.endpoint:.3f}" if row.errors else _EMPTY_CELL,
    "AAE, °": lambda row: f"{row.errors.angular:.2f}" if row.errors else _EMPTY_CELL,
    "Fl, %": lambda row: f"{100 * row.errors.outliers:.2f}" if row.errors else _EMPTY_CELL,
    "R1.0, %": lambda row: f"{100 * row.errors.over_one:.2f}" if row.errors else _EMPTY_CELL,
    "EPE noc": lambda row: f"{row.visible.endpoint:.3f}" if row.visible else _EMPTY_CELL,
    "EPE no sky": lambda row: f"{row.without_sky.endpoint:.3f}" if row.without_sky else _EMPTY_CELL,
    "occ F1, %": lambda row: _f1(row.occlusion),
}
_DEPTH_COLUMNS: dict[str, Callable[[DepthErrors], str]] = {
    "abs-rel": lambda errors: f"{errors.abs_rel:.3f}",
    "all": lambda errors: f"{errors.abs_rel_all:.3f}",
    "SILog": lambda errors: f"{errors.silog:.2f}",
    "δ1, %": lambda errors: f"{100 * errors.delta1:.1f}",
    "depth, %": lambda errors: f"{100 * errors.density:.1f}",
}
_POSE_COLUMNS: dict[str, Callable[[PoseErrors], str]] = {
    "direction, °": lambda errors: (
        _EMPTY_CELL if errors.direction is None else f"{errors.direction:.2f}"
    ),
    "rotation, °": lambda errors: f"{errors.rotation:.4f}",
}


_Errors = TypeVar("_Errors", DepthErrors, PoseErrors)


@dataclass(frozen=True)
class _Line:
    """One row: name, cells of all columns except the time, and the time, s."""

    name: str
    cells: list[str]
    seconds: float | None


def evaluation_tables(evaluation: Evaluation) -> list[Table]:
    """Return tables of flow, depth and pose, for the pairs with a known truth.

    Each table has a row for each pair, and rows for the mean (for depth and pose also the median)
    of each dataset with several pairs. With several datasets, rows for all pairs follow. A table of
    poses is returned if a pose was compared, or if only the pose of a pair is known.
    """
    flows = [pair for pair in evaluation.pairs if pair.pair.knows_flow]
    depths = [pair for pair in evaluation.pairs if pair.pair.knows_depth]
    poses = [pair for pair in evaluation.pairs if pair.pair.knows_pose]
    tables = []
    if flows:
        tables.append(_flow_table(flows))
    if depths:
        tables.append(_depth_table(depths))
    if any(pair.pose or not pair.pair.knows_depth for pair in poses):
        tables.append(_pose_table(poses))
    return tables


def _flow_table(pairs: Sequence[PairEvaluation]) -> Table:
    columns = dict(_FLOW_COLUMNS)
    notes = [
        "Fl: wrong by at least 3 px and 5 %; R1.0: by at least 1 px.",
        "Means are over pairs.",
        "Time of the interpretation alone, kernels compiled before.",
    ]
    if any(pair.visible for pair in pairs):
        notes.insert(1, "noc: without pixels that are occluded in the second frame.")
    else:
        del columns["EPE noc"]
    if not any(pair.without_sky for pair in pairs):
        del columns["EPE no sky"]
    if any(pair.occlusion for pair in pairs):
        notes.insert(-2, "occ F1: of the estimated occlusion against the dataset's.")
        notes[notes.index("Means are over pairs.")] = (
            "Means are over pairs, but occ F1 is over the pixels of all pairs."
        )
    else:
        del columns["occ F1, %"]

    def cells(row: _Row) -> list[str]:
        return [text(row) for text in columns.values()]

    def summaries(name: str, group: Sequence[PairEvaluation]) -> list[_Line]:
        means = mean_errors(group)
        if means is None:
            return []
        return [_Line(f"{name}, mean of {means.flow_pairs}", cells(means), means.seconds)]

    lines = [
        _Line(f"{pair.label} (failed)" if pair.fault else pair.label, cells(pair), pair.seconds)
        for pair in pairs
    ]
    return _table("Flow against the truth", notes, list(columns), pairs, lines, summaries)


def _depth_table(pairs: Sequence[PairEvaluation]) -> Table:
    notes = [
        "After scaling by the median of each pair. abs-rel: mean |ΔZ|/Z; all: the same over all "
        "pixels of known depth, where pixels without depth count as far; SILog: 100 times the "
        "deviation of log Z; δ1: wrong by a factor below 1.25; depth: share of the pixels of known "
        "depth that have depth."
    ]
    if any(pair.without_depth for pair in pairs):
        notes.append("Means and medians leave out pairs without depth.")
    return _errors_table(
        "Depth against the truth",
        notes,
        _DEPTH_COLUMNS,
        pairs,
        errors_of_pair=lambda pair: pair.depth,
        errors_of_means=lambda means: means.depth,
    )


def _pose_table(pairs: Sequence[PairEvaluation]) -> Table:
    notes = [
        "direction: angle between the translations, 180 if opposite; rotation: angle between the "
        "rotations."
    ]
    if not any(pair.pose for pair in pairs):
        notes.append("Only --motion camera estimates a pose.")
    if any(pair.pose and pair.pose.direction is None for pair in pairs):
        notes.append("Means and medians of the direction leave out pairs without direction.")
    return _errors_table(
        "Pose against the truth",
        notes,
        _POSE_COLUMNS,
        pairs,
        errors_of_pair=lambda pair: pair.pose,
        errors_of_means=lambda means: means.pose,
    )


def _errors_table(
    title: str,
    notes: Sequence[str],
    columns: dict[str, Callable[[_Errors], str]],
    pairs: Sequence[PairEvaluation],
    *,
    errors_of_pair: Callable[[PairEvaluation], _Errors | None],
    errors_of_means: Callable[[MeanErrors], ErrorSummary[_Errors] | None],
) -> Table:
    """Return a table with means, medians, and counts of pairs without errors by reason."""

    def cells(errors: _Errors | None) -> list[str]:
        return [text(errors) if errors else _EMPTY_CELL for text in columns.values()]

    def summaries(name: str, group: Sequence[PairEvaluation]) -> list[_Line]:
        means = mean_errors(group)
        summary = None if means is None else errors_of_means(means)
        lines = []
        if summary is not None and summary.pairs:
            seconds = [pair.seconds for pair in group if pair.seconds is not None]
            for statistic, errors, time in (
                ("mean", summary.mean, np.mean(seconds)),
                ("median", summary.median, np.median(seconds)),
            ):
                lines.append(
                    _Line(f"{name}, {statistic} of {summary.pairs}", cells(errors), float(time))
                )
        reasons = Counter(_missing_depth(pair) for pair in group if pair.fault is None)
        del reasons[""]
        return lines + [
            _Line(f"{name}, {reason}: {count}", cells(None), None)
            for reason, count in reasons.items()
        ]

    lines = []
    for pair in pairs:
        reason = "failed" if pair.fault is not None else _missing_depth(pair)
        name = f"{pair.label} ({reason})" if reason else pair.label
        lines.append(_Line(name, cells(errors_of_pair(pair)), pair.seconds))
    return _table(title, notes, list(columns), pairs, lines, summaries)


def _table(
    title: str,
    notes: Sequence[str],
    headings: Sequence[str],
    pairs: Sequence[PairEvaluation],
    lines: Sequence[_Line],
    summaries: Callable[[str, Sequence[PairEvaluation]], list[_Line]],
) -> Table:
    """Return a table of pairs, with summaries of each dataset and of all pairs."""
    table = Table(title=title, caption=" ".join(notes))
    table.add_column("", overflow="fold")
    for heading in (*headings, "s"):
        table.add_column(heading, justify="right", no_wrap=True)

    def add_lines(lines: Sequence[_Line], *, style: str | None = None) -> None:
        for line in lines:
            time = _EMPTY_CELL if line.seconds is None else f"{line.seconds:.2f}"
            # Text, because Rich reads square brackets in a plain string as markup.
            table.add_row(Text(line.name), *line.cells, time, style=style)

    groups: dict[str, list[int]] = {}
    for index, pair in enumerate(pairs):
        groups.setdefault(pair.pair.dataset, []).append(index)
    for name, members in groups.items():
        add_lines([lines[index] for index in members])
        if len(members) > 1:
            add_lines(summaries(name, [pairs[index] for index in members]), style="bold")
        table.add_section()
    if len(groups) > 1:
        add_lines(summaries("all", pairs), style="bold")
    return table


def _missing_depth(pair: PairEvaluation) -> str:
    """Return the reason why an interpretation has no depth; empty if it has depth."""
    if pair.little_parallax:
        return "too little parallax"
    return "no depth" if pair.without_depth else ""


def _f1(scores: OcclusionScores | None) -> str:
    """Return F1 in percent; no value if no pixel is occluded."""
    return f"{100 * scores.f1:.1f}" if scores is not None and scores.occluded else _EMPTY_CELL
