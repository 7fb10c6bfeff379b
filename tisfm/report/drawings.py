"""Drawings of a report, as SVG; their texts have the colour of the page's text."""

import io
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from tisfm.show import draw_path
from tisfm.show.draw_paths import PathView
from tisfm.show.palette import GRID_COLOR, RESULT_COLOR, TEXT_COLOR

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_POINTS = 400  # points of a curve; set by hand
MAX_PIECES = 4  # pieces with a drawn path; set by hand
_VIEWS: dict[PathView, str] = {"above": "from above", "side": "from the side"}


def path_drawing(
    poses: NDArray[np.float64],  # (N, 4, 4) float64: camera to world, NaN without a pose
    piece: NDArray[np.int32],  # (N,) int32: −1 without a pose
) -> Markup:  # two ``svg`` elements for each of the largest pieces; empty if no frame has a pose
    """Draw the path of the camera from above and from the side; each piece has its own scale."""
    numbers, counts = np.unique(piece[piece >= 0], return_counts=True)
    largest_pieces = numbers[np.argsort(-counts, kind="stable")][:MAX_PIECES]
    if not len(largest_pieces):
        return Markup()
    drawings = []
    for number in largest_pieces:
        in_piece = piece == number
        prefix = f"piece {number}, {in_piece.sum()} frames, " if len(numbers) > 1 else ""
        for view, name in _VIEWS.items():
            figure = _figure(4.0, 3.3)
            axes = figure.add_subplot()
            draw_path(poses[in_piece], axes=axes, view=view, title=f"{prefix}{name}")
            legend = axes.get_legend()
            if legend is not None:  # the page explains the path in its text
                legend.remove()
            drawings.append(_svg(figure))
    return Markup().join(drawings)


def curves_drawing(
    # name and numbers of each curve; None for a missing number
    curves: Sequence[tuple[str, Sequence[float | None]]],
) -> Markup:  # an ``svg`` element for each curve with more than one number
    """Draw curves of numbers over the pairs of a run."""
    known_curves = [
        (name, np.array([np.nan if value is None else value for value in values], np.float64))
        for name, values in curves
    ]
    known_curves = [
        (name, values) for name, values in known_curves if np.isfinite(values).sum() > 1
    ]
    drawings = []
    for name, values in known_curves:
        figure = _figure(4.0, 2.0)
        axes = figure.add_subplot()
        edges = np.linspace(0, len(values), min(len(values), _MAX_POINTS) + 1).astype(int)
        middles = (edges[:-1] + edges[1:] - 1) / 2
        means = [_mean(values[a:b]) for a, b in pairwise(edges)]
        marker = "." if len(means) <= 60 else ""
        axes.grid(color=GRID_COLOR, linewidth=0.5, alpha=0.4)
        axes.tick_params(colors=TEXT_COLOR, labelsize=8)
        for spine in axes.spines.values():
            spine.set(color=GRID_COLOR, linewidth=0.6)
        axes.plot(middles, means, color=RESULT_COLOR, linewidth=1.4, marker=marker)
        axes.set_title(name, color=TEXT_COLOR, fontsize=10)
        axes.set_xlim(-0.02 * len(values), 1.02 * len(values) - 1)
        axes.set_ylim(0, 1.08 * max(np.nanmax(means), 1e-6))
        axes.set_xlabel("pair", color=TEXT_COLOR, fontsize=9)
        axes.locator_params(axis="x", nbins=6, integer=True)
        axes.locator_params(axis="y", nbins=4)
        drawings.append(_svg(figure))
    return Markup().join(drawings)


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    figure.patch.set_visible(False)
    return figure


def _svg(figure: "Figure") -> Markup:
    """Return a figure as an ``svg`` element without a size; every run gives the same bytes.

    Matplotlib escapes the texts.
    """
    from matplotlib import rc_context

    for axes in figure.axes:
        axes.patch.set_visible(False)
    figure.tight_layout()
    data = io.StringIO()
    metadata: dict[str, Any] = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "tisfm"}):
        figure.savefig(data, format="svg", metadata=metadata)
    drawing = data.getvalue()
    drawing = drawing[drawing.index("<svg") :].strip()
    drawing = drawing.replace(TEXT_COLOR, "currentColor")  # the colour of the surrounding text
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    head, rest = drawing.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)
    assert box is not None
    return Markup(f'<svg {box[0]} role="img">{rest}')


def _mean(values: NDArray[np.float64]) -> float:
    known_values = values[np.isfinite(values)]
    return float(known_values.mean()) if len(known_values) else float("nan")
