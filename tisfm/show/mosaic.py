"""Figures as mosaics: rows of titled panels, and legends in the empty space.

Each panel draws itself into given axes, each legend into a given box of the figure.
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

# Pictures with at least this width over height are stacked, and their legends lie below them.
MIN_WIDE_RATIO = 2.0
_TITLE_SIZE = 9.0  # points
_HEADING_SIZE = 12.0  # points

# Lengths in inches, set by hand.
_MARGIN = 0.12
_GAP = 0.12  # between panels
_LEGEND_GAP = 0.25  # between stacked legends
_TITLE_LINE = 0.16  # height of a line of a title
_TITLE_GAP = 0.04  # between a title and its panel
_HEADING_LINE = 0.24  # height of a line of the heading
_CHARACTER_WIDTH = 0.075  # mean width of a character of a title, rounded up
_PANEL_AREA = 7.5  # square inches
_MIN_CELL_WIDTH = 1.9  # so that a title fits above a tall panel
_MAX_PANEL_SIDE = 5.5
_MIN_PANEL_SIDE = 0.3


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A titled picture of a mosaic."""

    title: str
    shape: tuple[int, int]  # height and width of the picture, px
    draw: Callable[[Axes], object]  # draws the picture into axes


@dataclass(frozen=True, kw_only=True)
class Legend:
    """A legend of a mosaic."""

    size: tuple[float, float]  # width and height, inches
    draw: Callable[[Figure, Box], object]  # draws the legend into a box of a figure


def stack_legends(legends: Sequence[Legend]) -> Legend:
    """Combine legends into one legend, from the top down."""

    def draw(figure: Figure, box: Box) -> None:
        figure_width, figure_height = figure.get_size_inches()
        left, bottom, _, height = box
        top = bottom + height
        for legend in legends:
            share = legend.size[1] / figure_height
            legend.draw(figure, (left, top - share, legend.size[0] / figure_width, share))
            top -= share + _LEGEND_GAP / figure_height

    heights = [legend.size[1] for legend in legends]
    total_height = sum(heights) + _LEGEND_GAP * (len(legends) - 1)
    return Legend(size=(max(legend.size[0] for legend in legends), total_height), draw=draw)


def join_legends(legends: Sequence[Legend]) -> Legend:
    """Combine legends into one legend, from the left to the right, with a common lower edge."""

    def draw(figure: Figure, box: Box) -> None:
        figure_width, figure_height = figure.get_size_inches()
        left, bottom, _, _ = box
        for legend in legends:
            width = legend.size[0] / figure_width
            legend.draw(figure, (left, bottom, width, legend.size[1] / figure_height))
            left += width

    widths = [legend.size[0] for legend in legends]
    return Legend(size=(sum(widths), max(legend.size[1] for legend in legends)), draw=draw)


def mosaic(
    rows: Sequence[Sequence[Panel]],  # rows may differ in length
    *,
    heading: str | None = None,  # heading above all panels
    # drawn at the empty end of the lowest row with enough space, else in an additional column
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
    """Return an empty white figure with the canvas Agg; `size` is width and height, inches."""
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

    Panels of every aspect ratio have about the same area, but their longer side is bounded. A very
    flat or narrow picture is enlarged along its shorter side, to stay visible.
    """
    panel_width = math.sqrt(_PANEL_AREA * width / height)
    panel_height = _PANEL_AREA / panel_width
    factor = min(1.0, _MAX_PANEL_SIDE / max(panel_width, panel_height))
    return max(panel_width * factor, _MIN_PANEL_SIDE), max(panel_height * factor, _MIN_PANEL_SIDE)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Positions in a grid of cells of one width; each cell has a title above a centred panel."""

    size: tuple[float, float]  # of the figure, inches
    panels: list[Box]  # row by row
    titles: list[str]  # with line breaks, so that lines fit above the panels
    heading: str  # with line breaks, so that lines fit into the figure
    legend: Box | None


def arrange(
    # sequence of sequences of (str, (float, float)): rows of panels: title, and width and height in
    # inches. Rows may differ in length.
    rows: Sequence[Sequence[tuple[str, tuple[float, float]]]],
    *,
    heading: str | None = None,  # heading above all panels
    # width and height, inches, of a legend. The legend goes to the empty end of the lowest row
    # with enough space, else into an additional narrow column.
    legend: tuple[float, float] | None = None,
) -> Layout:  # positions as shares of the figure, the panels of all rows in one list
    """Arrange panels in rows."""
    cell_width = max(_MIN_CELL_WIDTH, *(size[0] for row in rows for _, size in row))
    columns = max(len(row) for row in rows)
    heights = [max(size[1] for _, size in row) for row in rows]
    title_lines = [
        [textwrap.wrap(title, int(cell_width / _CHARACTER_WIDTH)) for title, _ in row]
        for row in rows
    ]
    legend_row = None
    if legend is not None:
        for i, row in enumerate(rows):
            empty_cells = columns - len(row)
            empty_width = empty_cells * cell_width + (empty_cells - 1) * _GAP
            if empty_cells and legend[0] <= empty_width and legend[1] <= heights[i]:
                legend_row = i
    width = 2 * _MARGIN + columns * cell_width + (columns - 1) * _GAP
    if legend is not None and legend_row is None:
        width += _GAP + legend[0]
    # Letters of the heading are larger than letters of a title.
    max_letters = int((width - 2 * _MARGIN) / _CHARACTER_WIDTH * _TITLE_SIZE / _HEADING_SIZE)
    heading_lines = textwrap.wrap(heading or "", max_letters)

    # Inches from the top down. Matplotlib counts from below, so y is flipped at the end.
    y = _MARGIN + len(heading_lines) * _HEADING_LINE
    boxes = []
    middles = []
    for row, row_title_lines, row_height in zip(rows, title_lines, heights, strict=True):
        y += max(len(text) for text in row_title_lines) * _TITLE_LINE + _TITLE_GAP
        for column, (_, size) in enumerate(row):
            x = _MARGIN + column * (cell_width + _GAP) + (cell_width - size[0]) / 2
            boxes.append((x, y, *size))
        middles.append(y + row_height / 2)
        y += row_height + _GAP
    height = y - _GAP + _MARGIN
    if legend is not None:
        if legend_row is None:
            height = max(height, legend[1] + 2 * _MARGIN)
            x, middle = width - _MARGIN - legend[0], height / 2
        else:
            empty_left = _MARGIN + len(rows[legend_row]) * (cell_width + _GAP)
            x, middle = (empty_left + width - _MARGIN - legend[0]) / 2, middles[legend_row]
        boxes.append((x, middle - legend[1] / 2, *legend))

    shares = [
        (left / width, 1 - (top + box_height) / height, box_width / width, box_height / height)
        for left, top, box_width, box_height in boxes
    ]
    titles = ["\n".join(text) for row_title_lines in title_lines for text in row_title_lines]
    return Layout(
        size=(width, height),
        panels=shares[: len(titles)],
        titles=titles,
        heading="\n".join(heading_lines),
        legend=None if legend is None else shares[-1],
    )
