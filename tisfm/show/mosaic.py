"""Figures as mosaics: rows of titled panels, and legends in the free space.

Every panel and every legend is drawn by a function that takes its axes.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tisfm.errors import MissingPackageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Box = tuple[float, float, float, float]  # left, bottom, width, height, as shares of the figure

WIDE = 2.0  # width over height of pictures from which they, and their legends, are stacked
_TITLE_SIZE = 9.0  # points
_HEADING_SIZE = 12.0  # points

# Lengths in inches, set by hand.
_MARGIN = 0.12
_GAP = 0.12  # between panels
_LEGEND_GAP = 0.25  # between stacked legends
_TITLE_LINE = 0.16  # height of a line of a title
_TITLE_GAP = 0.04  # between a title and its panel
_HEADING_LINE = 0.24  # height of a line of the heading
_CHARACTER = 0.075  # width of a mean character of a title, rounded up
_PANEL_AREA = 7.5  # square inches
_MIN_CELL_WIDTH = 1.9  # so that a title fits above a tall panel
_MAX_SIDE = 5.5  # of a panel
_MIN_SIDE = 0.3  # of a panel


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A titled picture of a mosaic."""

    title: str
    shape: tuple[int, int]  # height and width of the picture, px
    draw: Callable[[Axes], object]  # draws the picture into the axes that it is given


@dataclass(frozen=True, kw_only=True)
class Legend:
    """A legend of a mosaic."""

    size: tuple[float, float]  # width and height, inches
    draw: Callable[[Figure, Box], object]  # draws the legend into a box of a figure


def stacked(legends: Sequence[Legend]) -> Legend:
    """Return one legend made of several, from the top down."""

    def draw(figure: Figure, box: Box) -> None:
        wide, high = figure.get_size_inches()
        left, bottom, _, height = box
        top = bottom + height
        for legend in legends:
            share = legend.size[1] / high
            legend.draw(figure, (left, top - share, legend.size[0] / wide, share))
            top -= share + _LEGEND_GAP / high

    heights = [legend.size[1] for legend in legends]
    total = sum(heights) + _LEGEND_GAP * (len(legends) - 1)
    return Legend(size=(max(legend.size[0] for legend in legends), total), draw=draw)


def beside(legends: Sequence[Legend]) -> Legend:
    """Return one legend made of several, from the left, with a common lower edge."""

    def draw(figure: Figure, box: Box) -> None:
        wide, high = figure.get_size_inches()
        left, bottom, _, _ = box
        for legend in legends:
            width = legend.size[0] / wide
            legend.draw(figure, (left, bottom, width, legend.size[1] / high))
            left += width

    widths = [legend.size[0] for legend in legends]
    return Legend(size=(sum(widths), max(legend.size[1] for legend in legends)), draw=draw)


def mosaic(
    rows: Sequence[Sequence[Panel]],  # rows may differ in length
    *,
    heading: str | None = None,  # heading above all panels
    # drawn at the empty end of the lowest row with enough space, else in a column of its own
    legend: Legend | None = None,
) -> Figure:
    """Draw rows of panels in a new figure.

    Raises ImportError if Matplotlib is not installed.
    """
    layout = arrange(
        [[(panel.title, panel_size(*panel.shape)) for panel in row] for row in rows],
        heading=heading,
        legend=None if legend is None else legend.size,
    )
    figure = new_figure(layout.size)
    panels = [panel for row in rows for panel in row]
    height = layout.size[1]
    for box, title, panel in zip(layout.panels, layout.titles, panels, strict=True):
        panel.draw(figure.add_axes(box))
        x, y = box[0] + box[2] / 2, box[1] + box[3] + _TITLE_GAP / height
        write(figure, x, y, title, va="bottom", fontsize=_TITLE_SIZE)
    write(figure, 0.5, 1 - _MARGIN / height, layout.heading, va="top", fontsize=_HEADING_SIZE)
    if legend is not None and layout.legend is not None:
        legend.draw(figure, layout.legend)
    return figure


def new_figure(size: tuple[float, float]) -> Figure:
    """Return an empty white figure of a width and height in inches, drawn by Agg."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            "figures are drawn by Matplotlib: pip install matplotlib"
        ) from error
    figure = Figure(figsize=size, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def write(target: Figure | Axes, x: float, y: float, text: str, **style: Any) -> None:
    """Write centred text. A dollar sign does not begin a formula."""
    target.text(x, y, text, ha="center", color="black", parse_math=False, **style)


def panel_size(height: int, width: int) -> tuple[float, float]:
    """Return the width and height, inches, of the panel of a picture whose size is in pixels.

    All panels have about the same area, whatever their aspect ratio, up to a longest side. A very
    flat or narrow picture is stretched across, to stay visible.
    """
    shown_width = math.sqrt(_PANEL_AREA * width / height)
    shown_height = _PANEL_AREA / shown_width
    factor = min(1.0, _MAX_SIDE / max(shown_width, shown_height))
    return max(shown_width * factor, _MIN_SIDE), max(shown_height * factor, _MIN_SIDE)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Positions for a grid of equal cells, each of them a title above a centred panel."""

    size: tuple[float, float]  # of the figure, inches
    panels: list[Box]  # row by row
    titles: list[str]  # broken into lines that fit above their panels
    heading: str  # broken into lines that fit
    legend: Box | None


def arrange(
    # sequence of sequences of (str, (float, float)): rows of panels: title, and width and height in
    # inches. Rows may differ in length.
    rows: Sequence[Sequence[tuple[str, tuple[float, float]]]],
    *,
    heading: str | None = None,  # heading above all panels
    # width and height, inches, of a legend. It goes to the empty end of the lowest
    # row with enough space, else into a narrow column of its own.
    legend: tuple[float, float] | None = None,
) -> Layout:  # positions as shares of the figure, the panels of all rows in one list
    """Arrange panels in rows."""
    cell = max(_MIN_CELL_WIDTH, *(size[0] for row in rows for _, size in row))
    columns = max(len(row) for row in rows)
    heights = [max(size[1] for _, size in row) for row in rows]
    lines = [[textwrap.wrap(title, int(cell / _CHARACTER)) for title, _ in row] for row in rows]
    legend_row = None
    if legend is not None:
        for i, row in enumerate(rows):
            empty = columns - len(row)
            free = empty * cell + (empty - 1) * _GAP
            if empty and legend[0] <= free and legend[1] <= heights[i]:
                legend_row = i
    width = 2 * _MARGIN + columns * cell + (columns - 1) * _GAP
    if legend is not None and legend_row is None:
        width += _GAP + legend[0]
    # Letters of the heading are larger than letters of a title.
    letters = int((width - 2 * _MARGIN) / _CHARACTER * _TITLE_SIZE / _HEADING_SIZE)
    heading_lines = textwrap.wrap(heading or "", letters)

    # Inches from the top down. Matplotlib counts from below, so y is flipped at the end.
    y = _MARGIN + len(heading_lines) * _HEADING_LINE
    boxes = []
    middles = []
    for row, row_lines, row_height in zip(rows, lines, heights, strict=True):
        y += max(len(text) for text in row_lines) * _TITLE_LINE + _TITLE_GAP
        for column, (_, size) in enumerate(row):
            x = _MARGIN + column * (cell + _GAP) + (cell - size[0]) / 2
            boxes.append((x, y, *size))
        middles.append(y + row_height / 2)
        y += row_height + _GAP
    height = y - _GAP + _MARGIN
    if legend is not None:
        if legend_row is None:
            height = max(height, legend[1] + 2 * _MARGIN)
            x, middle = width - _MARGIN - legend[0], height / 2
        else:
            empty_from = _MARGIN + len(rows[legend_row]) * (cell + _GAP)
            x, middle = (empty_from + width - _MARGIN - legend[0]) / 2, middles[legend_row]
        boxes.append((x, middle - legend[1] / 2, *legend))

    shares = [
        (left / width, 1 - (upper + high) / height, wide / width, high / height)
        for left, upper, wide, high in boxes
    ]
    titles = ["\n".join(text) for row_lines in lines for text in row_lines]
    return Layout(
        size=(width, height),
        panels=shares[: len(titles)],
        titles=titles,
        heading="\n".join(heading_lines),
        legend=None if legend is None else shares[-1],
    )
