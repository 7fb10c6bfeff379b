"""Drawings of a report, as SVG whose text has the colour of the page."""

import io
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK, _FAINT = "#0a0b0c", "#8c8c8c"  # the first becomes the colour of the text around
_MOST_POINTS = 400  # of a path
MOST_PIECES = 4
_SHADES = -0.48, 1.13  # what would be the ends of the colours: they are not seen on every page
_BLUE, _ORANGE = "#0072b2", "#d55e00"


def path_drawing(poses: NDArray[np.float64], piece: NDArray[np.int32]) -> str:
    """Draw the places of the camera from above and from the side, each piece in its own scale.

    Parameters
    ----------
    poses : (N, 4, 4) float64
        Camera to world, NaN without one.
    piece : (N,) int32
        −1 without a pose.

    Returns
    -------
    str
        Two ``svg`` elements for each of the largest pieces; empty if no frame has a pose.
    """
    numbers, counts = np.unique(piece[piece >= 0], return_counts=True)
    shown = numbers[np.argsort(-counts, kind="stable")][:MOST_PIECES]
    if not len(shown):
        return ""
    drawings = []
    for number in shown:
        frames = np.flatnonzero(piece == number)
        kept = np.unique(np.linspace(0, len(frames) - 1, _MOST_POINTS).astype(int))
        places = poses[frames[kept], :3, 3]
        for across, up, title, names in _VIEWS:
            figure = _figure(4.0, 3.3)
            axes = figure.add_subplot()
            _draw_path(axes, places, across, up)
            said = f"piece {number}, {len(frames)} frames, " if len(numbers) > 1 else ""
            axes.set_title(f"{said}{title}", color=_INK, fontsize=10)
            axes.set_xlabel(names[0], color=_INK, fontsize=9)
            axes.set_ylabel(names[1], color=_INK, fontsize=9)
            axes.locator_params(nbins=5)
            drawings.append(_svg(figure))
    return "".join(drawings)


# Which axes are drawn, in which direction, and how they are called.
_VIEWS = (
    ((0, 1), (2, 1), "from above", ("X, right", "Z, forward")),
    ((2, 1), (1, -1), "from the side", ("Z, forward", "−Y, up")),
)


def curves_drawing(curves: Sequence[tuple[str, Sequence[float | None]]]) -> str:
    """Draw numbers over the pairs of a run.

    Parameters
    ----------
    curves : sequence of (str, sequence of float or None)
        What a curve shows, and its numbers; None where there is none.

    Returns
    -------
    str
        An ``svg`` element for each; empty if nothing has more than one number.
    """
    known = [
        (name, np.array([np.nan if value is None else value for value in values], np.float64))
        for name, values in curves
    ]
    known = [(name, values) for name, values in known if np.isfinite(values).sum() > 1]
    drawings = []
    for name, values in known:
        figure = _figure(4.0, 2.0)
        axes = figure.add_subplot()
        edges = np.linspace(0, len(values), min(len(values), _MOST_POINTS) + 1).astype(int)
        middles = (edges[:-1] + edges[1:] - 1) / 2
        means = [_mean(values[a:b]) for a, b in pairwise(edges)]
        dot = "." if len(means) <= 60 else ""
        axes.plot(middles, means, color=_BLUE, linewidth=1.4, marker=dot)
        axes.set_title(name, color=_INK, fontsize=10)
        axes.set_xlim(-0.02 * len(values), 1.02 * len(values) - 1)
        axes.set_ylim(0, 1.08 * max(np.nanmax(means), 1e-6))
        axes.set_xlabel("pair", color=_INK, fontsize=9)
        axes.locator_params(axis="x", nbins=6, integer=True)
        axes.locator_params(axis="y", nbins=4)
        drawings.append(_svg(figure))
    return "".join(drawings)


def _draw_path(
    axes: "Axes", places: NDArray[np.float64], across: tuple[int, int], up: tuple[int, int]
) -> None:
    """Draw places, (M, 3), by two of their axes, each with a sign; early is dark, late is light."""
    from matplotlib.collections import LineCollection

    x, y = (sign * places[:, axis] for axis, sign in (across, up))
    ends = np.stack([x, y], axis=1)
    segments = np.stack([ends[:-1], ends[1:]], axis=1)
    shades = np.linspace(0, 1, len(segments))
    line = LineCollection(list(segments), array=shades, cmap="cividis", linewidths=2.2)
    line.set_clim(*_SHADES)
    axes.add_collection(line)
    axes.scatter(x[:1], y[:1], s=46, marker="o", color=_BLUE, zorder=3)
    axes.scatter(x[-1:], y[-1:], s=46, marker="s", color=_ORANGE, zorder=3)
    # One scale for both directions; what does not move aside is not blown up to look as if.
    half = 0.58 * max(np.ptp(x), np.ptp(y), 0.35 * np.ptp(places, axis=0).max(), 1e-9)
    for set_limits, values in ((axes.set_xlim, x), (axes.set_ylim, y)):
        middle = (values.min() + values.max()) / 2
        set_limits(middle - half, middle + half)
    axes.set_aspect("equal", adjustable="box")


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    figure.patch.set_visible(False)
    return figure


def _svg(figure: "Figure") -> str:
    """Return a figure as an element without a size of its own, the same whenever it is drawn."""
    from matplotlib import rc_context

    for axes in figure.axes:
        axes.patch.set_visible(False)
        axes.grid(color=_FAINT, linewidth=0.5, alpha=0.4)
        axes.tick_params(colors=_INK, labelsize=8)
        for spine in axes.spines.values():
            spine.set(color=_FAINT, linewidth=0.6)
    figure.tight_layout()
    data = io.StringIO()
    about: dict[str, Any] = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "tisfm"}):
        figure.savefig(data, format="svg", metadata=about)
    drawing = data.getvalue()
    drawing = drawing[drawing.index("<svg") :].strip().replace(_INK, "currentColor")
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    head, rest = drawing.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)
    assert box is not None
    return f'<svg {box[0]} role="img">{rest}'


def _mean(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
