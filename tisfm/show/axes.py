"""Drawing into given axes: text and lines in proportion to the axes, and space for a legend.

Matplotlib is imported when something is drawn. It is used without pyplot, so that no global state
changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.show.mosaic import new_figure, panel_size
from tisfm.show.palette import GRID_COLOR, TEXT_COLOR
from tisfm.show.ticks import select_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.legend import Legend

# All numbers here are set by hand, by the look of the pictures.
_PICTURE_TEXT_SHARE = 0.028  # text height around a picture, divided by the mean side of the axes
_PLOT_TEXT_SHARE = 0.036  # text height around a plot, divided by the mean side of the axes
_MIN_TEXT_PIXELS = 9.0  # px: smaller text is hard to read
_MAX_PIXELS_PER_AXES_PIXEL = 2  # finer pictures are reduced before they are drawn
_MIN_REDUCED_PPI = 250  # pixels per inch of the figure: up to this resolution nothing is reduced
_MARGIN = 0.3  # inches around the picture, in a figure with one picture
_LEGEND_WIDTH = 1.0  # inches for a legend beside the picture
_LEGEND_HEIGHT = 0.4  # inches for a legend below the picture
_CHARACTER_WIDTH = 0.6  # mean width of a character divided by the text height
_MAX_SIDE_RATIO = 12  # longer side over shorter side: a longer picture is widened to stay visible


@dataclass
class _LegendSpace:
    """The division of the area of axes between a picture and its legends."""

    divider: Any
    legends: list[Axes] = field(default_factory=list)


_LEGEND_SPACE = "_tisfm_legend_space"  # name of the attribute of axes with their `_LegendSpace`


@dataclass(frozen=True)
class Sizes:
    """Sizes of text and lines in proportion to axes, points."""

    text: float  # height
    line: float  # width

    @property
    def text_inches(self) -> float:
        """Height of the text, inches."""
        return self.text / 72


def sizes_for(axes: Axes, text_share: float = _PICTURE_TEXT_SHARE) -> Sizes:
    """Return sizes of text and lines that suit axes, from a thumbnail to a whole screen."""
    box = axes.get_window_extent()
    pixels = max(_MIN_TEXT_PIXELS, text_share * math.sqrt(max(box.width * box.height, 1.0)))
    points = pixels * 72 / axes.figure.dpi
    return Sizes(text=points, line=points / 7)


def picture_axes(height: int, width: int, *, legend_below: bool = False) -> Axes:
    """Return axes in a new figure, for a picture, in px, with a legend beside or below it."""
    panel_width, panel_height = panel_size(height, width)
    legend_width, legend_height = (0.0, _LEGEND_HEIGHT) if legend_below else (_LEGEND_WIDTH, 0.0)
    size = panel_width + legend_width + 2 * _MARGIN, panel_height + legend_height + 2 * _MARGIN
    figure = new_figure(size)
    left, bottom = _MARGIN / size[0], _MARGIN / size[1]
    return figure.add_axes((left, bottom, 1 - 2 * left, 1 - 2 * bottom))


def plot_axes(width: float, height: float) -> Axes:
    """Return axes for curves in a new figure, whose width and height are in inches."""
    figure = new_figure((width, height))
    figure.set_layout_engine("constrained")
    return figure.add_subplot()


def show_picture(
    axes: Axes,  # modified in place: earlier contents are removed
    # (H, W) or (H, W, 3) uint8 ndarray: an image finer than the axes is reduced by averaging pixels
    image: NDArray[np.uint8],
    title: str | None = None,  # text above the picture
) -> Sizes:
    """Show a picture in axes with the unit px, y downwards; return sizes of text and lines."""
    _clear_axes(axes)
    sizes = sizes_for(axes)
    rows, columns = image.shape[:2]
    box = axes.get_window_extent()
    max_pixel_ratio = max(_MAX_PIXELS_PER_AXES_PIXEL, _MIN_REDUCED_PPI / axes.figure.dpi)
    reduced_size = (
        max(1, min(columns, math.ceil(max_pixel_ratio * box.width))),
        max(1, min(rows, math.ceil(max_pixel_ratio * box.height))),
    )
    reduced_image = cv2.resize(
        np.ascontiguousarray(image), reduced_size, interpolation=cv2.INTER_AREA
    )
    is_elongated = max(rows, columns) > _MAX_SIDE_RATIO * min(rows, columns)
    axes.imshow(
        reduced_image,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5),
        aspect="auto" if is_elongated else "equal",
        interpolation="antialiased",
        origin="upper",
    )
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color=GRID_COLOR, linewidth=0.5 * sizes.line)
    if title is not None:
        write_title(axes, title, sizes)
    return sizes


def write_title(axes: Axes, title: str, sizes: Sizes) -> None:
    """Write a title above axes. A dollar sign does not begin a formula."""
    axes.set_title(title, fontsize=1.15 * sizes.text, color=TEXT_COLOR, parse_math=False)


def write_centered(axes: Axes, sizes: Sizes, text: str) -> None:
    """Write a text in the middle of empty axes, such as the reason why they are empty."""
    axes.text(
        0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=sizes.text,
        color=TEXT_COLOR, parse_math=False,
    )  # fmt: skip


def style_plot(axes: Axes, title: str | None = None) -> Sizes:
    """Empty axes, give them the style of all plots, and return sizes for text and lines."""
    _clear_axes(axes)
    axes.set_aspect("auto")
    sizes = sizes_for(axes, _PLOT_TEXT_SHARE)
    axes.grid(color=GRID_COLOR, linewidth=0.4 * sizes.line, alpha=0.4)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=sizes.text, colors=TEXT_COLOR, width=0.5 * sizes.line)
    for spine in axes.spines.values():
        spine.set(color=GRID_COLOR, linewidth=0.5 * sizes.line)
    if title is not None:
        write_title(axes, title, sizes)
    return sizes


def disable_formulas(legend: Legend) -> None:
    """Make dollar signs in a legend ordinary characters, which do not begin a formula."""
    for text in legend.get_texts():
        text.set_parse_math(False)


def label_axes(axes: Axes, sizes: Sizes, x: str, y: str) -> None:
    """Write the quantities and units along both axes of a plot."""
    axes.set_xlabel(x, fontsize=sizes.text, color=TEXT_COLOR, parse_math=False)
    axes.set_ylabel(y, fontsize=sizes.text, color=TEXT_COLOR, parse_math=False)


def limit_ticks(axes: Axes, sizes: Sizes) -> None:
    """Limit the number of ticks to the space for their labels."""
    from matplotlib.ticker import MaxNLocator

    box = axes.get_window_extent()
    character_height = sizes.text_inches * axes.figure.dpi  # px
    for axis, space in ((axes.xaxis, box.width / 6), (axes.yaxis, box.height / 3)):
        axis.set_major_locator(MaxNLocator(nbins=int(np.clip(space / character_height, 2, 8))))


def draw_bar(
    axes: Axes,  # axes of the picture
    ramp: NDArray[np.uint8],  # (N, 3) uint8 ndarray: colours from the smallest to the largest value
    # sequence of (float, str): positions along the bar, rising from 0 to 1, and their labels. The
    # labels of both ends are always written, the labels between them if there is space.
    ticks: Sequence[tuple[float, str]],
    *,
    label: str,  # the quantity and its unit
    short_label: str,  # label if there is no space for `label`
    sizes: Sizes,
    is_below: bool,  # whether the bar lies below the picture, else beside the picture
) -> Axes:  # axes of the bar
    """Draw a colour bar beside or below a picture, and shrink the picture to make space."""
    max_length = max(len(text) for _, text in ticks)
    character = _CHARACTER_WIDTH * sizes.text_inches
    width, height = _picture_size(axes)
    if is_below:
        bar = _side_axes(axes, "bottom", 0.8 * sizes.text_inches, 0.6 * sizes.text_inches)
        _side_axes(axes, "bottom", 3.2 * sizes.text_inches, 0).set_axis_off()
        bar.imshow(ramp[None], extent=(0, 1, 0, 1), aspect="auto", interpolation="bilinear")
        spaced_ticks = select_ticks(ticks, 1.5 * (max_length + 1) * character / width)
        bar.set_yticks([])
        bar.set_xticks(
            [position for position, _ in spaced_ticks], [text for _, text in spaced_ticks]
        )
        first, *_, last = bar.get_xticklabels()
        first.set_horizontalalignment("left")  # keeps both labels within the picture
        last.set_horizontalalignment("right")
        name = label if len(label) * character < width else short_label
        bar.set_xlabel(name, fontsize=sizes.text, color=TEXT_COLOR, labelpad=2, parse_math=False)
    else:
        bar = _side_axes(axes, "right", 0.8 * sizes.text_inches, 0.6 * sizes.text_inches)
        label_width = max_length * character + 2.6 * sizes.text_inches
        _side_axes(axes, "right", label_width, 0).set_axis_off()
        bar.imshow(ramp[::-1, None], extent=(0, 1, 0, 1), aspect="auto", interpolation="bilinear")
        bar_height = max(width - label_width - 1.4 * sizes.text_inches, 0.0) * height / width
        spaced_ticks = select_ticks(ticks, 1.6 * sizes.text_inches / max(bar_height, 1e-6))
        bar.yaxis.tick_right()
        bar.yaxis.set_label_position("right")
        bar.set_xticks([])
        bar.set_yticks(
            [position for position, _ in spaced_ticks], [text for _, text in spaced_ticks]
        )
        name = label if len(label) * character < min(height, bar_height) else short_label
        bar.set_ylabel(name, fontsize=sizes.text, color=TEXT_COLOR, labelpad=2, parse_math=False)
    bar.set(xlim=(0, 1), ylim=(0, 1))
    bar.tick_params(
        labelsize=sizes.text,
        colors=TEXT_COLOR,
        pad=2,
        length=0.3 * sizes.text,
        width=0.5 * sizes.line,
    )
    for spine in bar.spines.values():
        spine.set(color=GRID_COLOR, linewidth=0.5 * sizes.line)
    return bar


def _clear_axes(axes: Axes) -> None:
    """Remove the contents and legends of axes, and restore the position of the axes."""
    space = getattr(axes, _LEGEND_SPACE, None)
    if space is not None:
        delattr(axes, _LEGEND_SPACE)
        for legend in space.legends:
            legend.remove()
        axes.set_axes_locator(None)  # type: ignore[arg-type]
    axes.clear()
    is_in_layout = axes.get_in_layout()
    axes.reset_position()
    axes.set_in_layout(is_in_layout)  # reset_position takes axes out of the layout


def legend_axes(axes: Axes, width: float, gap: float) -> Axes:
    """Return empty axes at the right side of a picture; width and gap are in inches."""
    legend = _side_axes(axes, "right", width, gap)
    legend.set_axis_off()
    return legend


def _side_axes(axes: Axes, side: str, size: float, gap: float) -> Axes:
    """Return new axes at a side of given axes, which become smaller when they are drawn."""
    from mpl_toolkits.axes_grid1.axes_divider import make_axes_locatable

    space = getattr(axes, _LEGEND_SPACE, None)
    if space is None:
        space = _LegendSpace(divider=make_axes_locatable(axes))
        setattr(axes, _LEGEND_SPACE, space)
    legend: Axes = space.divider.append_axes(side, size=size, pad=gap)
    space.legends.append(legend)
    return legend


def _picture_size(axes: Axes) -> tuple[float, float]:
    """Return the width and height, inches, of a picture in axes without a legend."""
    box = axes.get_window_extent()
    width, height = max(box.width, 1.0) / axes.figure.dpi, max(box.height, 1.0) / axes.figure.dpi
    if axes.get_aspect() == "auto":
        return width, height
    columns, rows = (abs(end - start) for start, end in (axes.get_xlim(), axes.get_ylim()))
    return min(width, height * columns / rows), min(height, width * rows / columns)
