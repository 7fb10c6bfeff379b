"""Errors over the ratio of the focal length taken to the true one, as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from bench.shared.curves import CURVES

ROWS = {
    "abs_rel": "depth, abs-rel",
    "direction": "direction, °",
    "rotation": "rotation, °",
    "field_flow": "flow of the field, EPE, px",
}
TICKS = (0.5, 0.75, 1.0, 1.33, 2.0)
MARKERS = ("o", "s", "^", "v")
FEW_DECADES = 30.0  # ratio of the largest error to the smallest
LEAST = 1e-4  # of errors on a logarithmic axis


def draw(outcomes: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the picture of outcomes, as `bench.focal.Outcome` has them."""
    picture(outcomes).savefig(path)


def picture(outcomes: Sequence[Mapping[str, Any]]) -> Figure:
    """Return a row of axes for every error and a column for every true focal length."""
    focals = sorted({outcome["focal"] for outcome in outcomes})
    kinds = list(dict.fromkeys(outcome["kind"] for outcome in outcomes))
    size = (3.2 * len(focals) + 0.4, 2.1 * len(ROWS) + 0.8)
    figure = Figure(figsize=size, dpi=130, layout="constrained")
    grid = figure.subplots(len(ROWS), len(focals), sharex=True, sharey="row", squeeze=False)
    for row, (name, title) in enumerate(ROWS.items()):
        for column, focal in enumerate(focals):
            axes = grid[row, column]
            for kind, colour, marker in zip(kinds, CURVES, MARKERS, strict=False):
                mine = [o for o in outcomes if (o["kind"], o["focal"]) == (kind, focal)]
                known = [(o["ratio"], max(o[name], LEAST)) for o in mine if o[name] is not None]
                if known:
                    axes.plot(
                        *zip(*known, strict=True),
                        marker=marker,
                        color=colour,
                        markersize=4,
                        linewidth=1.2,
                        label=kind,
                    )
            _scale(axes, [o[name] for o in outcomes if o[name] is not None])
            if row == 0:
                axes.set_title(f"true focal length {focal:g} px", fontsize=10)
            if column == 0:
                axes.set_ylabel(title, fontsize=9)
            if row == len(ROWS) - 1:
                axes.set_xlabel("focal length taken / true", fontsize=9)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(kinds), fontsize=9)
    return figure


def _scale(axes: Axes, values: Sequence[float]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(FixedLocator(TICKS))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    if max(values) < FEW_DECADES * max(min(values), LEAST):
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.axvline(1.0, color="0.6", linewidth=0.8, linestyle=":")
    axes.grid(alpha=0.25, which="major", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
