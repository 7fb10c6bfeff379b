"""Tables of a comparison on sequences: one for each figure, and one for each sequence."""

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from bench.sequences.contest import Score, SequenceContest
from bench.shared.results import (
    EMPTY_CELL,
    Table,
    cell,
    markdown_page,
    missing_sections,
    print_missing,
    write_results,
)
from tisfm.evaluation.sequences import SequenceEvaluation

NOTES = (
    "ATE: root mean square distance of the camera centres of the largest piece from the true ones, "
    "after the best similarity, in % of the true path of the whole sequence. Frames with a pose: "
    "in all pieces. Each piece has its own world and scale. Largest: its share of the frames.",
    "Depth error: |ΔZ|/Z over all pixels of known depth. The whole sequence has one scale, the "
    "median of true over estimated depth (1 if the poses were given). Estimates are limited to "
    "[0.1 min Z, 10 max Z]; a pixel without depth counts as 10 max Z, a frame without depth as an "
    "error of 1. True depth beyond 40 m does not count. Surest 40 %: the pixels with the smallest "
    "relative deviation, each error limited to 3. Medians over frames. Pixels: share of the pixels "
    "of known depth for which the method has a depth. Within deviations: shares of the pixels "
    "whose error of inverse depth is within one / two standard deviations, means over frames.",
    "Keyframes, between them, and at outlines: mean over frames of the mean error, limited as "
    "above, / share of the pixels with an error above 10 %. Outlines: within 8 px of neighbours "
    "whose true inverse depths differ by more than 10 %, unless linear extrapolation from one side "
    "gives the other within 5 %. HoloLens and 7-Scenes, whose sensors blur: within 4 px of a "
    "square of 9 px in which they differ by more than 20 %.",
    "Spread: standard deviation of the logarithm of the best scale of a frame. Flicker: mean "
    "change of relative inverse depth (estimated times true depth) from a frame to the next, along "
    "the true flow.",
    "Chained pairs: pairs of consecutive frames; the depth of earlier pairs gives the scale of "
    "each. Pairs: the same without a common scale. pycolmap: SIFT, sequential matching, "
    "incremental mapping, intrinsics given.",
    "Camera unknown: principal point in the centre, no distortion, and an estimated focal length. "
    "Its column has the difference from the true focal length and the estimated deviation; "
    "doubted: the result itself calls the estimate unreliable.",
    "Seconds per frame: from files to path and depth, without output; median over the rounds. "
    "Memory: peak resident memory of the process, including libraries.",
)

Column = tuple[str, Callable[[Score], str]]


def _evaluation_cell(figure: Callable[[SequenceEvaluation], str | None]) -> Callable[[Score], str]:
    """Return the cell of a score: a figure of its evaluation, or empty."""
    return lambda score: (score.evaluation and figure(score.evaluation)) or EMPTY_CELL


def _ate(evaluation: SequenceEvaluation) -> str | None:
    share = evaluation.pieces[0].share if evaluation.pieces else None
    return None if share is None else f"{100 * share:.2f}"


def _metres(evaluation: SequenceEvaluation) -> str | None:
    absolute = evaluation.pieces[0].absolute if evaluation.pieces else None
    return None if absolute is None else f"{absolute.similarity:.4f}"


def _depth_cell(name: str, form: str, factor: float = 1.0) -> Callable[[Score], str]:
    def text(evaluation: SequenceEvaluation) -> str:
        value = None if evaluation.depth is None else getattr(evaluation.depth, name)
        return cell(None if value is None else factor * value, form)

    return _evaluation_cell(text)


def _within(evaluation: SequenceEvaluation) -> str | None:
    within = evaluation.depth and evaluation.depth.within
    return " / ".join(f"{100 * share:.0f}" for share in within) if within else None


def _group_cell(group: str, names: tuple[str, str]) -> Callable[[Score], str]:
    """Return the cell of a group of frames: mean error and share of wrong pixels, %."""

    def text(evaluation: SequenceEvaluation) -> str | None:
        errors = None if evaluation.depth is None else getattr(evaluation.depth, group)
        if errors is None:
            return None
        values = [getattr(errors, name) for name in names]
        return None if None in values else " / ".join(f"{100 * value:.1f}" for value in values)

    return _evaluation_cell(text)


WHOLE, OUTLINE = ("error", "wrong"), ("outline_error", "outline_wrong")


def _focal_cell(score: Score) -> str:
    if score.focal is None:
        return EMPTY_CELL
    difference, deviation, reliable = score.focal
    return f"{100 * difference:+.1f} ± {100 * deviation:.1f}{'' if reliable else ', doubted'}"


COLUMNS: tuple[Column, ...] = (
    ("ATE, %", _evaluation_cell(_ate)),
    ("m", _evaluation_cell(_metres)),
    (
        "frames with a pose",
        _evaluation_cell(lambda evaluation: f"{evaluation.posed} of {evaluation.frames}"),
    ),
    ("pieces", _evaluation_cell(lambda evaluation: str(len(evaluation.pieces) or ""))),
    (
        "largest, %",
        _evaluation_cell(lambda e: f"{100 * e.largest_share:.0f}" if e.pieces else None),
    ),
    ("depth error", _depth_cell("error", ".3f")),
    ("surest 40 %", _depth_cell("certain", ".3f")),
    ("within deviations, %", _evaluation_cell(_within)),
    ("pixels, %", _depth_cell("share", ".1f", 100)),
    ("keyframes, %", _group_cell("keyframes", WHOLE)),
    ("at outlines, %", _group_cell("keyframes", OUTLINE)),
    ("between, %", _group_cell("between", WHOLE)),
    ("between at outlines, %", _group_cell("between", OUTLINE)),
    ("spread", _depth_cell("scale_spread", ".3f")),
    ("flicker", _depth_cell("flicker", ".4f")),
    ("focal length, % off", _focal_cell),
    ("s per frame", lambda score: cell(score.per_frame, ".2f")),
    ("memory, MB", lambda score: cell(score.peak and score.peak / 1e6, ".0f")),
)
SUMMARY = ("ATE, %", "depth error", "flicker", "focal length, % off")


def summary(contest: SequenceContest, heading: str) -> Table:
    """Return one figure: a row for every method, a column for every sequence."""
    text = dict(COLUMNS)[heading]
    sequences, methods = _names(contest)
    cells = {(score.method, score.sequence): text(score) for score in contest.scores}
    rows = [
        [method, *(cells.get((method, sequence), EMPTY_CELL) for sequence in sequences)]
        for method in methods
    ]
    rows = [row for row in rows if any(cell != EMPTY_CELL for cell in row[1:])]
    return Table(["method", *sequences], rows)


def details(contest: SequenceContest, sequence: str) -> Table:
    """Return all figures of a sequence, without the columns that no method fills."""
    scores = [score for score in contest.scores if score.sequence == sequence]
    rows = [[score.method, *(text(score) for _, text in COLUMNS)] for score in scores]
    head = ["method", *(name for name, _ in COLUMNS)]
    return Table(head, rows).without_empty_columns()


def show(contest: SequenceContest, console: Console) -> None:
    """Print the summaries, and the missing and failed methods."""
    for heading, table in _summaries(contest).items():
        console.print(heading)
        console.print(table.rich())
    print_missing(console, contest.missing, contest.failures)


def write(contest: SequenceContest, path: Path) -> None:
    blocks: list[str | Table | Sequence[str]] = []
    for heading, table in _summaries(contest).items():
        blocks += [f"## {heading[0].upper()}{heading[1:]}", table]
    sections: list[str | Table] = []
    for sequence in _names(contest)[0]:
        sections += [f"## {sequence}", details(contest, sequence)]
    text = markdown_page(
        "# Sequences: path and depth",
        contest.conditions,
        *blocks,
        NOTES,
        *missing_sections(contest.missing, contest.failures),
        *sections,
    )
    write_results(path, text, contest.as_json())


def _summaries(contest: SequenceContest) -> dict[str, Table]:
    """Return the tables of single figures that are not empty."""
    tables = {heading: summary(contest, heading) for heading in SUMMARY}
    return {heading: table for heading, table in tables.items() if table.rows}


def _names(contest: SequenceContest) -> tuple[list[str], list[str]]:
    """Return sequences and methods, in the order of their scores."""
    sequences = list(dict.fromkeys(score.sequence for score in contest.scores))
    return sequences, list(dict.fromkeys(score.method for score in contest.scores))
