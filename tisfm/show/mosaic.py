"""Where the panels of a figure go."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tisfm.errors import InputError

Box = tuple[float, float, float, float]  # left, bottom, width, height, as shares of the figure

WIDE = 2.0  # width over height from which pictures, and legends, go below one another
TITLE_SIZE = 9.0  # points
HEADING_SIZE = 12.0  # points

# All lengths in inches.
_MARGIN = 0.12
_GAP = 0.12
_LEGEND_GAP = 0.25  # between legends below one another
_TITLE_LINE = 0.16
_TITLE_GAP = 0.04  # between a title and its panel
_HEADING_LINE = 0.24
_CHARACTER = 0.075  # width of a mean character of a title, generously
_PANEL_AREA = 7.5  # square inches
_NARROWEST_CELL = 1.9  # room for a title above a tall panel
_LONGEST_SIDE = 5.5
_SHORTEST_SIDE = 0.3


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Positions for a grid of equal cells, each of them a title above a panel in its middle."""

    size: tuple[float, float]  # of the figure, inches
    panels: list[Box]  # row by row
    titles: list[str]  # broken into lines that fit above their panels
    heading: str  # broken into lines that fit
    legend: Box | None  # room for a legend, if one was asked for

    @property
    def title_gap(self) -> float:
        """Distance from a panel to its title, as a share of the figure."""
        return _TITLE_GAP / self.size[1]

    @property
    def top(self) -> float:
        """Top of the heading, as a share of the figure."""
        return 1 - _MARGIN / self.size[1]


def panel_size(height: int, width: int) -> tuple[float, float]:
    """Return the width and height, inches, at which a picture of a size in pixels is shown.

    All panels have about the same area, whatever their aspect ratio, up to a longest side. An
    extremely flat or narrow picture gets a panel that is wider than its own ratio, to stay visible.
    """
    shown_width = math.sqrt(_PANEL_AREA * width / height)
    shown_height = _PANEL_AREA / shown_width
    factor = min(1.0, _LONGEST_SIDE / max(shown_width, shown_height))
    return max(shown_width * factor, _SHORTEST_SIDE), max(shown_height * factor, _SHORTEST_SIDE)


def stacked_size(sizes: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the width and height, inches, of legends of these sizes below one another."""
    heights = [height for _, height in sizes]
    return max(width for width, _ in sizes), sum(heights) + _LEGEND_GAP * (len(sizes) - 1)


def stack_legends(layout: Layout, sizes: Sequence[tuple[float, float]]) -> list[Layout]:
    """Divide the room for a legend of `stacked_size`.

    Parameters
    ----------
    layout : Layout
        With that room.
    sizes : sequence of (float, float)
        Width and height of each legend, inches, from the top down.

    Returns
    -------
    list of Layout
        The layout once for every legend, which it has room for.
    """
    if layout.legend is None:
        raise InputError("layout has no room for a legend: ask draw_panels for it")
    left, bottom, _, height = layout.legend
    top = bottom + height
    layouts = []
    for wide, high in sizes:
        share = high / layout.size[1]
        layouts.append(replace(layout, legend=(left, top - share, wide / layout.size[0], share)))
        top -= share + _LEGEND_GAP / layout.size[1]
    return layouts


def beside_size(sizes: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the width and height, inches, of legends of these sizes beside one another."""
    return sum(width for width, _ in sizes), max(height for _, height in sizes)


def beside_legends(layout: Layout, sizes: Sequence[tuple[float, float]]) -> list[Layout]:
    """Divide the room for a legend of `beside_size`.

    Parameters
    ----------
    layout : Layout
        With that room.
    sizes : sequence of (float, float)
        Width and height of each legend, inches, from the left. They end at one height below.

    Returns
    -------
    list of Layout
        The layout once for every legend, which it has room for.
    """
    if layout.legend is None:
        raise InputError("layout has no room for a legend: ask draw_panels for it")
    left, bottom, _, _ = layout.legend
    layouts = []
    for wide, high in sizes:
        box = left, bottom, wide / layout.size[0], high / layout.size[1]
        layouts.append(replace(layout, legend=box))
        left += box[2]
    return layouts


def arrange(
    rows: Sequence[Sequence[tuple[str, tuple[float, float]]]],
    *,
    heading: str | None = None,
    legend: tuple[float, float] | None = None,
) -> Layout:
    """Arrange panels in rows.

    Parameters
    ----------
    rows : sequence of sequences of (str, (float, float))
        Rows of panels, each the title and the width and height, inches. Rows may differ in length.
    heading : str, optional
        Heading above all of them.
    legend : (float, float), optional
        Width and height, inches, of a legend. It goes to the empty end of the lowest row that has
        room for it, else into a narrow column of its own.

    Returns
    -------
    Layout
        Positions as shares of the figure, the panels of all rows in one list.
    """
    cell = max(_NARROWEST_CELL, *(size[0] for row in rows for _, size in row))
    columns = max(len(row) for row in rows)
    heights = [max(size[1] for _, size in row) for row in rows]
    lines = [[textwrap.wrap(title, int(cell / _CHARACTER)) for title, _ in row] for row in rows]
    roomy = None
    if legend is not None:
        for i, row in enumerate(rows):
            empty = columns - len(row)
            room = empty * cell + (empty - 1) * _GAP
            if empty and legend[0] <= room and legend[1] <= heights[i]:
                roomy = i
    width = 2 * _MARGIN + columns * cell + (columns - 1) * _GAP
    if legend is not None and roomy is None:
        width += _GAP + legend[0]
    # Letters of the heading are larger than those of a title.
    letters = int((width - 2 * _MARGIN) / _CHARACTER * TITLE_SIZE / HEADING_SIZE)
    heading_lines = textwrap.wrap(heading or "", letters)

    # From the top down, in inches; turned round at the end because a figure counts from below.
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
        if roomy is None:
            height = max(height, legend[1] + 2 * _MARGIN)
            x, middle = width - _MARGIN - legend[0], height / 2
        else:
            empty_from = _MARGIN + len(rows[roomy]) * (cell + _GAP)
            x, middle = (empty_from + width - _MARGIN - legend[0]) / 2, middles[roomy]
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
