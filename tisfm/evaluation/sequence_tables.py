"""The tables that `tisfm eval --sequence` prints."""

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from tisfm.evaluation.sequences import PieceErrors, SequenceEvaluation

_EMPTY_CELL = "–"


def sequence_tables(evaluations: Sequence[SequenceEvaluation]) -> list[Table]:
    """Return tables of paths and of depth, for the evaluations with a known truth.

    The table of paths has a row for every piece, the largest first. The table of depth has a row
    for every sequence.
    """
    tables = []
    paths = [
        evaluation
        for evaluation in evaluations
        if evaluation.fault or (evaluation.path is not None and not evaluation.poses_given)
    ]
    if paths:
        tables.append(_path_table(paths))
    depths = [evaluation for evaluation in evaluations if evaluation.depth is not None]
    if depths:
        tables.append(_depth_table(depths))
    return tables


def _path_table(evaluations: Sequence[SequenceEvaluation]) -> Table:
    headings = ("frames", "ATE, %", "m", "rigid, %", "RPE, m", "°", "RPE 10, m", "°", "drift, %",
                "°/m", "s")  # fmt: skip
    table = Table(
        title="Paths against the truth",
        caption="ATE: root mean square distance of the centres after the best similarity, in % of "
        "the true path and in m; rigid: after the best rigid motion. RPE: of the motions from "
        "frame to frame, and to the tenth after it; drift: of the motions along 10–80 % of the "
        "path, or along 100–800 m, per length. All but rigid are in the scale of the alignment. A "
        "row for each piece.",
    )
    table.add_column("", overflow="fold")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for evaluation in evaluations:
        seconds = _format_number(evaluation.seconds, ".1f")
        if evaluation.fault or not evaluation.pieces:
            reason = "failed" if evaluation.fault else "no pose"
            cells = [_EMPTY_CELL] * (len(headings) - 1)
            table.add_row(Text(f"{evaluation.sequence.name} ({reason})"), *cells, seconds)
        for number, piece in enumerate(evaluation.pieces):
            name = evaluation.sequence.name if number == 0 else "  another piece"
            frames = f"{piece.frames} of {evaluation.frames}"
            time = seconds if number == 0 else ""
            table.add_row(Text(name), frames, *_path_cells(piece), time)
    return table


def _path_cells(piece: PieceErrors) -> list[str]:
    absolute, drift = piece.absolute, piece.drift
    cells = [
        _format_percent(piece.share),
        _EMPTY_CELL if absolute is None else f"{absolute.similarity:.4f}",
        _format_percent(piece.rigid_share),
    ]
    for relative in (piece.relative, piece.relative_step):
        if relative is None:
            cells += [_EMPTY_CELL, _EMPTY_CELL]
        else:
            cells += [f"{relative.translation:.4f}", f"{relative.rotation:.3f}"]
    if drift is None:
        return [*cells, _EMPTY_CELL, _EMPTY_CELL]
    return [*cells, _format_percent(drift.translation), f"{drift.rotation:.3f}"]


def _depth_table(evaluations: Sequence[SequenceEvaluation]) -> Table:
    table = Table(
        title="Depth of sequences against the truth",
        caption="In one scale for all frames of a sequence, 1 where the poses were given. error: "
        "|ΔZ|/Z over all pixels of known depth, where pixels without depth count as infinitely "
        "far and a frame without depth as 1; surest: over the 40 % with the smallest relative "
        "deviation; both are medians over frames. within: pixels within one / two standard "
        "deviations. pixels: share with depth. spread: standard "
        "deviation of the logarithm of the best scale of a frame; flicker: mean change of relative "
        "inverse depth along the true flow.",
    )
    table.add_column("", overflow="fold")
    for heading in (
        "frames",
        "error",
        "surest 40 %",
        "within, %",
        "pixels, %",
        "spread",
        "flicker",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for evaluation in evaluations:
        depth = evaluation.depth
        assert depth is not None
        table.add_row(
            Text(evaluation.sequence.name),
            f"{depth.frames - depth.without} of {depth.frames}",
            f"{depth.error:.3f}",
            _format_number(depth.certain, ".3f"),
            " / ".join(f"{100 * share:.0f}" for share in depth.within or ()) or _EMPTY_CELL,
            f"{100 * depth.share:.1f}",
            _format_number(depth.scale_spread, ".3f"),
            _format_number(depth.flicker, ".4f"),
        )
    return table


def _format_number(value: float | None, format_spec: str) -> str:
    return _EMPTY_CELL if value is None else f"{value:{format_spec}}"


def _format_percent(value: float | None) -> str:
    return _EMPTY_CELL if value is None else f"{100 * value:.2f}"
