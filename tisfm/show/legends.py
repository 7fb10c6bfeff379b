"""The parts that figures are drawn from: titled panels, arrows, and the legend of both.

Matplotlib is imported when the first figure is drawn, and used without pyplot: nothing global is
touched.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError, MissingPackageError
from tisfm.show.flow import color_wheel, quiver_points
from tisfm.show.mosaic import HEADING_SIZE, TITLE_SIZE, Box, Layout, arrange, panel_size
from tisfm.show.ticks import depth_ticks, with_room

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Width and height of legends, inches.
LEGEND_SIZE = (1.3, 1.8)
WHEEL_SIZE = (1.3, 1.2)
BAR_SIZE = (1.15, 1.75)
DEPTH_BAR_SIZE = (1.0, 2.05)
_SWATCH = 0.14  # side of a swatch
_SWATCH_LINE = 0.2
_MOST_SWATCHES = 12  # labels beyond are counted
_LEGEND_TEXT = 8.0  # points
_LEGEND_LINE = 0.15  # inches: what a tick needs
_PIXELS_PER_INCH = 250  # of a panel: finer pictures are reduced before they are drawn
_ARROW_SPACING = 0.17  # inches
_ARROW_LENGTH = 2.0  # of motion as long as the limit, in spacings
_LONGEST_ARROW = 3.0  # times the limit
_ARROW_STYLE: dict[str, Any] = {
    "angles": "xy",
    "scale_units": "xy",
    "scale": 1.0,
    "units": "inches",
    "width": 0.018,
    "headwidth": 3.6,
    "headlength": 4.2,
    "headaxislength": 3.6,
    "minlength": 0.8,
    "facecolor": "#ffdd33",
    "edgecolor": "black",
    "linewidth": 0.35,
}


def draw_panels(
    rows: Sequence[Sequence[tuple[str, NDArray[np.uint8]]]],
    *,
    heading: str | None = None,
    legend: tuple[float, float] | None = None,
) -> tuple[Figure, list[Axes], Layout]:
    """Draw rows of titled pictures.

    Parameters
    ----------
    rows : sequence of sequences of (str, ndarray)
        Titles and (H, W) or (H, W, 3) uint8 pictures. Rows may differ in length.
    heading : str, optional
        Heading above all of them.
    legend : (float, float), optional
        Width and height, inches, of the room to leave for a legend.

    Returns
    -------
    figure : matplotlib.figure.Figure
        The figure.
    axes : list of matplotlib.axes.Axes
        The panels of all rows, in pixels of their pictures, y downwards.
    layout : Layout
        Where everything is.

    Raises
    ------
    ImportError
        If Matplotlib is not installed.
    """
    layout = arrange(
        [[(title, panel_size(*image.shape[:2])) for title, image in row] for row in rows],
        heading=heading,
        legend=legend,
    )
    figure = new_figure(layout.size)
    pictures = [image for row in rows for _, image in row]
    axes = []
    for box, title, image in zip(layout.panels, layout.titles, pictures, strict=True):
        panel = figure.add_axes(box)
        _draw_image(panel, image, box[2] * layout.size[0], box[3] * layout.size[1])
        x, y = box[0] + box[2] / 2, box[1] + box[3] + layout.title_gap
        _write(figure, x, y, title, va="bottom", fontsize=TITLE_SIZE)
        axes.append(panel)
    _write(figure, 0.5, layout.top, layout.heading, va="top", fontsize=HEADING_SIZE)
    return figure, axes, layout


def arrow_scale(shape: tuple[int, int], limit: float) -> tuple[int, float]:
    """Choose the grid and the length of the arrows over a picture.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the picture, px.
    limit : float
        Motion that counts as long, px/frame; not 0.

    Returns
    -------
    step : int
        Distance of the arrows, px.
    magnification : float
        Length drawn per length of motion.
    """
    pixels_per_inch = shape[1] / panel_size(*shape)[0]
    spacing = _ARROW_SPACING * pixels_per_inch
    return max(1, round(spacing)), _ARROW_LENGTH * spacing / limit


def draw_arrows(axes: Axes, flow: NDArray[np.floating[Any]], limit: float) -> None:
    """Draw a flow as arrows over the picture in a panel.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Panel, in pixels; modified in place.
    flow : (H, W, 2) ndarray
        Flow, px/frame.
    limit : float
        Motion that counts as long, px/frame. Arrows end at three times it; at 0 there are none.
    """
    if limit == 0:
        return
    step, magnification = arrow_scale(flow.shape[:2], limit)
    arrows = quiver_points(flow, step)
    length = np.hypot(arrows.u, arrows.v)
    # One wild vector would be drawn across everything else.
    factor = magnification * np.minimum(1, _LONGEST_ARROW * limit / np.maximum(length, limit))
    axes.quiver(arrows.x, arrows.y, arrows.u * factor, arrows.v * factor, **_ARROW_STYLE)


def draw_legend(figure: Figure, layout: Layout, shape: tuple[int, int], limit: float) -> None:
    """Draw the colour wheel, and an arrow of a round length below it.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure of `draw_panels` with room for a legend; modified in place.
    layout : Layout
        Where that room is.
    shape : (int, int)
        Height and width of the pictures with arrows, px.
    limit : float
        Motion at the rim of the wheel, px/frame.
    """
    if layout.legend is None:
        raise InputError("layout has no room for a legend: ask draw_panels for it")
    axes = _draw_wheel_in(figure, layout.legend, LEGEND_SIZE, limit)
    middle = LEGEND_SIZE[0] / 2
    if limit == 0:
        return
    length = _round_below(limit)
    _, magnification = arrow_scale(shape, limit)
    inches = length * magnification * panel_size(*shape)[0] / shape[1]
    axes.quiver([middle - inches / 2], [0.36], [inches], [0.0], **_ARROW_STYLE)
    _write(axes, middle, 0.24, f"{length:g} px/frame", va="top", fontsize=_LEGEND_TEXT)


def draw_wheel(figure: Figure, layout: Layout, limit: float) -> None:
    """Draw the colour wheel alone.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure of `draw_panels` with room for a legend of `WHEEL_SIZE`; modified in place.
    layout : Layout
        Where that room is.
    limit : float
        Motion at the rim of the wheel, px/frame.
    """
    if layout.legend is None:
        raise InputError("layout has no room for a legend: ask draw_panels for it")
    _draw_wheel_in(figure, layout.legend, WHEEL_SIZE, limit)


def draw_color_bar(
    figure: Figure,
    layout: Layout,
    ramp: NDArray[np.uint8],
    limits: tuple[float, float],
    *,
    unit: str,
) -> None:
    """Draw a vertical bar of colours with a logarithmic scale.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure of `draw_panels` with room for a legend of `BAR_SIZE`; modified in place.
    layout : Layout
        Where that room is.
    ramp : (N, 1, 3) uint8 ndarray
        Colours from the top of the scale to its bottom.
    limits : (float, float)
        Values at the bottom and at the top; beyond them is what has the colours of the ends.
    unit : str
        Unit of the values.
    """
    if layout.legend is None:
        raise InputError("layout has no room for a legend: ask draw_panels for it")
    axes = _inch_axes(figure, layout.legend, BAR_SIZE)
    _, right, bottom, top = box = 0.1, 0.28, 0.08, BAR_SIZE[1] - 0.08
    _draw_ramp(axes, ramp, box)
    low, high = limits
    span = math.log2(high) - math.log2(low)
    # Doublings as long as they leave room for their labels, else every other one, and so on.
    doublings = math.floor(span + 1e-9)
    for k in range(0, doublings + 1, 1 + doublings // 10):
        value = math.ldexp(low, k)
        y = bottom + (top - bottom) * k / span
        sign = "≤ " if k == 0 else "≥ " if value >= high * (1 - 1e-9) else ""
        _draw_tick(axes, right, y, f"{sign}{value:.3g} {unit}")


def draw_depth_bar(
    figure: Figure,
    layout: Layout,
    ramp: NDArray[np.uint8],
    limit: float,
    *,
    label: str,
) -> None:
    """Draw a vertical bar of colours that are linear in inverse depth, with round depths beside it.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure of `draw_panels` with room for a legend of `DEPTH_BAR_SIZE`; modified in place.
    layout : Layout
        Where that room is.
    ramp : (256, 3) uint8 ndarray
        Colours from infinitely far to near.
    limit : float
        Inverse depth of the last colour.
    label : str
        What is written above it, in two lines at most, with its unit.
    """
    if layout.legend is None:
        raise InputError("layout has no room for a legend: ask draw_panels for it")
    axes = _inch_axes(figure, layout.legend, DEPTH_BAR_SIZE)
    left, right, bottom, top = box = 0.1, 0.28, 0.08, DEPTH_BAR_SIZE[1] - 0.42
    _draw_ramp(axes, ramp[::-1, None], box)
    for share, text in with_room(depth_ticks(limit), _LEGEND_LINE / (top - bottom)):
        _draw_tick(axes, right, bottom + share * (top - bottom), text)
    axes.text(
        left,
        top + 0.1,
        label,
        va="bottom",
        fontsize=_LEGEND_TEXT,
        parse_math=False,
    )


def swatches_size(count: int) -> tuple[float, float]:
    """Return the width and height, inches, of the legend of so many labels."""
    lines = min(count, _MOST_SWATCHES) + (count > _MOST_SWATCHES)
    return BAR_SIZE[0], _SWATCH_LINE * lines


def draw_swatches(
    figure: Figure, layout: Layout, colors: NDArray[np.uint8], names: Sequence[str]
) -> None:
    """Draw a list of colours and what they stand for; many are counted.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure of `draw_panels` with room for a legend of `swatches_size`; modified in place.
    layout : Layout
        Where that room is.
    colors : (K, 3) uint8 ndarray
        Colours red, green, blue.
    names : sequence of str
        Their names.
    """
    if layout.legend is None:
        raise InputError("layout has no room for a legend: ask draw_panels for it")
    size = swatches_size(len(colors))
    axes = _inch_axes(figure, layout.legend, size)
    left = 0.1
    for k, color in enumerate(colors[:_MOST_SWATCHES]):
        y = size[1] - (k + 0.5) * _SWATCH_LINE
        axes.imshow(
            color[None, None],
            extent=(left, left + _SWATCH, y - _SWATCH / 2, y + _SWATCH / 2),
            aspect="auto",
        )
        axes.text(
            left + _SWATCH + 0.08,
            y,
            names[k],
            va="center",
            fontsize=_LEGEND_TEXT,
            parse_math=False,
        )
    if len(colors) > _MOST_SWATCHES:
        more = f"and {len(colors) - _MOST_SWATCHES} more"
        axes.text(left, 0.5 * _SWATCH_LINE, more, va="center", fontsize=_LEGEND_TEXT)
    axes.set(xlim=(0, size[0]), ylim=(0, size[1]))  # which a picture in them changes


def backdrop(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture as dim grey levels, from which bright arrows stand out."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    return np.rint(grey * np.float32(0.6)).astype(np.uint8)


def _inch_axes(figure: Figure, box: Box, size: tuple[float, float]) -> Axes:
    """Return invisible axes, in inches from their lower left corner."""
    axes = figure.add_axes(box)
    axes.set(xlim=(0, size[0]), ylim=(0, size[1]))
    axes.set_axis_off()
    return axes


def _draw_ramp(axes: Axes, ramp: NDArray[np.uint8], box: Box) -> None:
    """Draw colours, from the top down, with a thin frame: left, right, bottom and top in inches."""
    left, right, bottom, top = box
    axes.imshow(ramp, extent=box, aspect="auto", interpolation="nearest")
    axes.plot(
        [left, right, right, left, left], [bottom, bottom, top, top, bottom], color="0.5", lw=0.6
    )


def _draw_tick(axes: Axes, x: float, y: float, text: str) -> None:
    axes.plot([x, x + 0.05], [y, y], color="0.3", lw=0.6)
    axes.text(x + 0.09, y, text, va="center", fontsize=_LEGEND_TEXT)


def _draw_wheel_in(figure: Figure, box: Box, size: tuple[float, float], limit: float) -> Axes:
    """Draw the colour wheel at the top of a legend, its range below; return the axes, in inches."""
    axes = _inch_axes(figure, box, size)
    middle, radius = size[0] / 2, 0.48
    wheel_middle = size[1] - radius
    axes.imshow(
        color_wheel(int(2 * radius * _PIXELS_PER_INCH)),
        extent=(middle - radius, middle + radius, wheel_middle - radius, wheel_middle + radius),
        aspect="auto",
    )
    rim = f"rim: ≥ {limit:.0f} px/frame" if limit >= 100 else f"rim: ≥ {limit:.2g} px/frame"
    _write(axes, middle, size[1] - 2 * radius - 0.05, rim, va="top", fontsize=_LEGEND_TEXT)
    return axes


def new_figure(size: tuple[float, float]) -> Figure:
    """Return an empty white figure that is drawn by Agg."""
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


def _draw_image(axes: Axes, image: NDArray[np.uint8], width: float, height: float) -> None:
    """Show a picture in a panel of a size in inches, one unit per pixel, with a thin frame."""
    rows, columns = image.shape[:2]
    smaller = (
        min(columns, math.ceil(width * _PIXELS_PER_INCH)),
        min(rows, math.ceil(height * _PIXELS_PER_INCH)),
    )
    reduced = cv2.resize(np.ascontiguousarray(image), smaller, interpolation=cv2.INTER_AREA)
    axes.imshow(
        reduced,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5),
        aspect="auto",
        interpolation="antialiased",
        origin="upper",
    )
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color="0.5", linewidth=0.6)


def _write(where: Figure | Axes, x: float, y: float, text: str, **style: Any) -> None:
    """Write text, centred; a dollar sign in it is a dollar sign."""
    where.text(x, y, text, ha="center", color="black", parse_math=False, **style)


def _round_below(value: float) -> float:
    """Return the greatest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** math.floor(math.log10(value))
    # The tolerance lets 0.2 be found for 0.2, which is 2 times a power that is a little too great.
    return max(digit * power for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-9))
