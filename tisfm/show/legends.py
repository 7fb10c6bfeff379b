"""Legends that several panels of a mosaic share: colour wheel, colour bars, list of labels.

Each legend is drawn in axes whose unit is an inch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tisfm.show.draw_flow import ARROW_STYLE, arrow_scale
from tisfm.show.flow import color_wheel
from tisfm.show.mosaic import Box, Legend, panel_size, write
from tisfm.show.palette import color_ramp, colors_of_categories
from tisfm.show.ticks import depth_ticks, doubling_ticks, select_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Lengths in inches, set by hand. Sizes are width and height of a whole legend.
_WHEEL_SIZE = (1.3, 1.2)
_WHEEL_AND_ARROW_SIZE = (1.3, 1.8)
_ERROR_BAR_SIZE = (1.15, 1.75)
_DEPTH_BAR_SIZE = (1.0, 2.05)
_WHEEL_RADIUS = 0.48
_BAR_LEFT, _BAR_RIGHT = 0.1, 0.28  # edges of a bar, from the left of the legend
_BAR_MARGIN = 0.08  # space below and above a bar
_DEPTH_LABEL_HEIGHT = 0.42  # of the label above the bar of depth
_SWATCH = 0.14  # side of a square of colour
_SWATCH_LINE = 0.2  # height of a line with a square of colour
_TICK_LINE = 0.15  # height of the label of a tick
# Other numbers, set by hand.
_MAX_LABELS = 12  # labels in a legend; further labels are only counted
_TEXT_SIZE = 8.0  # points
_WHEEL_PIXELS_PER_INCH = 250


def wheel_legend(limit: float) -> Legend:
    """Return the colour wheel of flow; its rim shows a motion of `limit`, px/frame."""
    return _in_inches(_WHEEL_SIZE, partial(_draw_wheel, size=_WHEEL_SIZE, limit=limit))


def flow_legend(
    shape: tuple[int, int],  # height and width of the pictures with arrows, px
    limit: float,  # motion at the rim of the wheel, px/frame
) -> Legend:
    """Return the colour wheel of flow, and below it an arrow with its motion, a round number."""
    size = _WHEEL_AND_ARROW_SIZE

    def draw(axes: Axes) -> None:
        _draw_wheel(axes, size=size, limit=limit)
        if limit == 0:
            return
        middle, motion = size[0] / 2, _round_down(limit)
        _, magnification = arrow_scale(shape, limit)
        inches = motion * magnification * panel_size(*shape)[0] / shape[1]
        axes.quiver([middle - inches / 2], [0.36], [inches], [0.0], **ARROW_STYLE)
        write(axes, middle, 0.24, f"{motion:g} px/frame", va="top", fontsize=_TEXT_SIZE)

    return _in_inches(size, draw)


def error_legend(
    # errors at the bottom and at the top of the bar; smaller and larger errors have the end colours
    limits: tuple[float, float],
    unit: str,  # unit of the errors
) -> Legend:
    """Return a vertical bar of the colours of errors, with a logarithmic scale."""

    def draw(axes: Axes) -> None:
        top = _ERROR_BAR_SIZE[1] - _BAR_MARGIN
        _draw_bar(axes, color_ramp("error"), top, doubling_ticks(limits, unit))

    return _in_inches(_ERROR_BAR_SIZE, draw)


def depth_legend(
    limit: float,  # inverse depth at the top of the bar
    label: str,  # quantity and unit, written above the bar in two lines at most
    *,
    # (256, 3) uint8 ndarray: colours from infinitely far to near, by default those of
    # `tisfm.show.depth_to_color`
    ramp: NDArray[np.uint8] | None = None,
) -> Legend:
    """Return a vertical bar of colours, linear in inverse depth, labelled by round depths."""
    colors = color_ramp("depth") if ramp is None else ramp

    def draw(axes: Axes) -> None:
        top = _DEPTH_BAR_SIZE[1] - _DEPTH_LABEL_HEIGHT
        _draw_bar(axes, colors, top, depth_ticks(limit))
        axes.text(_BAR_LEFT, top + 0.1, label, va="bottom", fontsize=_TEXT_SIZE, parse_math=False)

    return _in_inches(_DEPTH_BAR_SIZE, draw)


def label_legend(labels: Sequence[int], names: Sequence[str]) -> Legend:
    """Return a legend with the colour and name of each label, up to `_MAX_LABELS` labels."""
    lines = min(len(labels), _MAX_LABELS) + (len(labels) > _MAX_LABELS)
    size = _ERROR_BAR_SIZE[0], _SWATCH_LINE * lines
    colors = colors_of_categories(np.array(labels))

    def draw(axes: Axes) -> None:
        left = _BAR_LEFT
        for k, color in enumerate(colors[:_MAX_LABELS]):
            y = size[1] - (k + 0.5) * _SWATCH_LINE
            extent = (left, left + _SWATCH, y - _SWATCH / 2, y + _SWATCH / 2)
            axes.imshow(color[None, None], extent=extent, aspect="auto")
            axes.text(
                left + _SWATCH + 0.08, y, names[k], va="center", fontsize=_TEXT_SIZE,
                parse_math=False,
            )  # fmt: skip
        if len(colors) > _MAX_LABELS:
            count_text = f"and {len(colors) - _MAX_LABELS} more"
            axes.text(left, 0.5 * _SWATCH_LINE, count_text, va="center", fontsize=_TEXT_SIZE)
        axes.set(xlim=(0, size[0]), ylim=(0, size[1]))  # imshow has changed the limits

    return _in_inches(size, draw)


def _in_inches(size: tuple[float, float], draw: Callable[[Axes], object]) -> Legend:
    """Return a legend whose `draw` gets invisible axes, in inches from their lower left corner."""

    def draw_in_box(figure: Figure, box: Box) -> None:
        axes = figure.add_axes(box)
        axes.set(xlim=(0, size[0]), ylim=(0, size[1]))
        axes.set_axis_off()
        draw(axes)

    return Legend(size=size, draw=draw_in_box)


def _draw_bar(
    axes: Axes, ramp: NDArray[np.uint8], top: float, ticks: Sequence[tuple[float, str]]
) -> None:
    """Draw a vertical bar of colours up to the height `top`, with a thin frame and ticks."""
    left, right, bottom = _BAR_LEFT, _BAR_RIGHT, _BAR_MARGIN
    extent = (left, right, bottom, top)
    axes.imshow(ramp[::-1, None], extent=extent, aspect="auto", interpolation="nearest")
    axes.plot(
        [left, right, right, left, left], [bottom, bottom, top, top, bottom], color="0.5", lw=0.6
    )
    for share, text in select_ticks(ticks, _TICK_LINE / (top - bottom)):
        y = bottom + share * (top - bottom)
        axes.plot([right, right + 0.05], [y, y], color="0.3", lw=0.6)
        axes.text(right + 0.09, y, text, va="center", fontsize=_TEXT_SIZE)


def _draw_wheel(axes: Axes, *, size: tuple[float, float], limit: float) -> None:
    """Draw the colour wheel at the top of a legend, and below it the motion at its rim."""
    middle, radius = size[0] / 2, _WHEEL_RADIUS
    center = size[1] - radius
    axes.imshow(
        color_wheel(int(2 * radius * _WHEEL_PIXELS_PER_INCH)),
        extent=(middle - radius, middle + radius, center - radius, center + radius),
        aspect="auto",
    )
    rim = f"rim: ≥ {limit:.0f} px/frame" if limit >= 100 else f"rim: ≥ {limit:.2g} px/frame"
    write(axes, middle, size[1] - 2 * radius - 0.05, rim, va="top", fontsize=_TEXT_SIZE)


def _round_down(value: float) -> float:
    """Return the largest round number up to a value: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    # With the tolerance the result for 0.2 is 0.2: the product 2 · 10⁻¹ can be rounded upwards.
    return max(digit * power for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-9))
