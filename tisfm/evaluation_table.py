"""The table that `tisfm eval` prints."""

from collections.abc import Callable

from rich.table import Table
from rich.text import Text

from tisfm.evaluation import Evaluation, MeanErrors, PairEvaluation
from tisfm.metrics import OcclusionScores

_NOTHING = "–"
_Row = PairEvaluation | MeanErrors

# Heading, and the text of a row; some are columns only where a pair has such an error.
_COLUMNS: dict[str, Callable[[_Row], str]] = {
    "EPE, px": lambda row: f"{row.errors.endpoint:.3f}" if row.errors else _NOTHING,
    "AAE, °": lambda row: f"{row.errors.angular:.2f}" if row.errors else _NOTHING,
    "Fl, %": lambda row: f"{100 * row.errors.outliers:.2f}" if row.errors else _NOTHING,
    "R1.0, %": lambda row: f"{100 * row.errors.over_one:.2f}" if row.errors else _NOTHING,
    "EPE noc": lambda row: f"{row.visible.endpoint:.3f}" if row.visible else _NOTHING,
    "EPE no sky": lambda row: f"{row.without_sky.endpoint:.3f}" if row.without_sky else _NOTHING,
    "occ F1, %": lambda row: _f1(row.occlusion),
    "s": lambda row: f"{row.seconds:.2f}" if row.seconds is not None else _NOTHING,
}


def _f1(scores: OcclusionScores | None) -> str:
    """Return F1 in percent, where there is something to find."""
    return f"{100 * scores.f1:.1f}" if scores is not None and scores.occluded else _NOTHING


def evaluation_table(evaluation: Evaluation) -> Table:
    """Lay out an evaluation as a table, with the means of each dataset and of all pairs.

    Parameters
    ----------
    evaluation : Evaluation

    Returns
    -------
    rich.table.Table
        One row per pair, one for the mean of each dataset of more than one pair, and one for the
        mean of all if there is more than one dataset.
    """
    noc = any(pair.visible for pair in evaluation.pairs)
    sky = any(pair.without_sky for pair in evaluation.pairs)
    occlusion = any(pair.occlusion for pair in evaluation.pairs)
    columns = dict(_COLUMNS)
    notes = [
        "Fl: off by at least 3 px and 5 %; R1.0: by at least 1 px.",
        "Means are over pairs.",
        "Time of the interpretation alone, kernels compiled before.",
    ]
    if noc:
        notes.insert(1, "noc: without what is occluded in the second frame.")
    else:
        del columns["EPE noc"]
    if not sky:
        del columns["EPE no sky"]
    if occlusion:
        notes.insert(-2, "occ F1: of our map of occlusion against the dataset's.")
        notes[notes.index("Means are over pairs.")] = (
            "Means are over pairs, but occ F1 is over the pixels of all of them."
        )
    else:
        del columns["occ F1, %"]
    table = Table(title="Flow against the truth", caption=" ".join(notes))
    table.add_column("", overflow="fold")
    for heading in columns:
        table.add_column(heading, justify="right", no_wrap=True)

    def add(label: str, row: _Row, *, style: str | None = None, end: bool = False) -> None:
        # Text, because in a plain string square brackets would be markup.
        cells = [text(row) for text in columns.values()]
        table.add_row(Text(label), *cells, style=style, end_section=end)

    for name, pairs in evaluation.datasets.items():
        mean = evaluation.dataset_means[name] if len(pairs) > 1 else None
        for pair in pairs:
            failed = " (failed)" if pair.fault is not None else ""
            add(f"{pair.label}{failed}", pair, end=mean is None and pair is pairs[-1])
        if mean is not None:
            add(f"{name}, mean of {mean.pairs}", mean, style="bold", end=True)
    if len(evaluation.datasets) > 1 and evaluation.mean is not None:
        add(f"all, mean of {evaluation.mean.pairs}", evaluation.mean, style="bold")
    return table
