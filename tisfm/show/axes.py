"""Drawing into axes that are given: text and lines in proportion to them, and room for a legend.

Matplotlib is imported when something is drawn, and used without pyplot: nothing global is touched.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.show.legends import new_figure
from tisfm.show.mosaic import panel_size
from tisfm.show.palette import FAINT, INK
from tisfm.show.ticks import with_room

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.legend import Legend

# Height of text as a share of the mean side of the axes.
_TEXT_OF_PICTURE, _TEXT_OF_PLOT = 0.028, 0.036
_LEAST_TEXT = 9.0  # px: less is not read
_MOST_PIXELS = 2  # of a picture per pixel of the axes: what is finer is reduced
_AROUND, _ROOM_ASIDE, _ROOM_BELOW = 0.3, 1.0, 0.4  # inches, of a picture in a figure of its own
_CHARACTER = 0.6  # width of a mean character, in its height
_FLATTEST = 12  # ratio of the sides of a picture: flatter ones are stretched, to stay visible


@dataclass
class _Place:
    """How the place of axes is divided, and among which others."""

    divider: Any
    rooms: list[Axes] = field(default_factory=list)


_PLACE = "_tisfm_place"  # the attribute of axes that keeps it as long as they live


@dataclass(frozen=True)
class Sizes:
    """Sizes in proportion to axes, points."""

    text: float
    line: float

    @property
    def inch(self) -> float:
        """Height of the text, inches."""
        return self.text / 72


def sizes_for(axes: Axes, share: float = _TEXT_OF_PICTURE) -> Sizes:
    """Return sizes of text and lines that are read in axes, from a thumbnail to a whole screen."""
    box = axes.get_window_extent()
    pixels = max(_LEAST_TEXT, share * math.sqrt(max(box.width * box.height, 1.0)))
    points = pixels * 72 / axes.figure.dpi
    return Sizes(text=points, line=points / 7)


def picture_axes(height: int, width: int, *, below: bool = False) -> Axes:
    """Return axes for a picture and its legend, beside or below, in a figure of their own."""
    wide, high = panel_size(height, width)
    aside, under = (0.0, _ROOM_BELOW) if below else (_ROOM_ASIDE, 0.0)
    size = wide + aside + 2 * _AROUND, high + under + 2 * _AROUND
    figure = new_figure(size)
    left, bottom = _AROUND / size[0], _AROUND / size[1]
    return figure.add_axes((left, bottom, 1 - 2 * left, 1 - 2 * bottom))


def plot_axes(width: float, height: float) -> Axes:
    """Return axes for curves in a figure of their own, of a size in inches."""
    figure = new_figure((width, height))
    figure.set_layout_engine("constrained")
    return figure.add_subplot()


def show_picture(axes: Axes, image: NDArray[np.uint8], title: str | None = None) -> Sizes:
    """Show a picture in axes, in its pixels, y downwards, and return the sizes for what is around.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Modified in place; what was in them is removed.
    image : (H, W) or (H, W, 3) uint8 ndarray
        What is finer than the axes is reduced: a mean of pixels, not every so many.
    title : str, optional
        Text above it.
    """
    _empty(axes)
    sizes = sizes_for(axes)
    rows, columns = image.shape[:2]
    box = axes.get_window_extent()
    smaller = (
        max(1, min(columns, math.ceil(_MOST_PIXELS * box.width))),
        max(1, min(rows, math.ceil(_MOST_PIXELS * box.height))),
    )
    reduced = cv2.resize(np.ascontiguousarray(image), smaller, interpolation=cv2.INTER_AREA)
    is_flat = max(rows, columns) > _FLATTEST * min(rows, columns)
    axes.imshow(
        reduced,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5),
        aspect="auto" if is_flat else "equal",
        interpolation="antialiased",
        origin="upper",
    )
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color=FAINT, linewidth=0.5 * sizes.line)
    if title is not None:
        write_title(axes, title, sizes)
    return sizes


def write_title(axes: Axes, title: str, sizes: Sizes) -> None:
    """Write a title above axes; a dollar sign in it is a dollar sign."""
    axes.set_title(title, fontsize=1.15 * sizes.text, color=INK, parse_math=False)


def write_inside(axes: Axes, sizes: Sizes, text: str) -> None:
    """Write in the middle of axes why there is nothing else."""
    axes.text(
        0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=sizes.text,
        color=INK, parse_math=False,
    )  # fmt: skip


def style_plot(axes: Axes, title: str | None = None) -> Sizes:
    """Empty axes, make them look like all plots, and return the sizes for what is in them."""
    _empty(axes)
    axes.set_aspect("auto")
    sizes = sizes_for(axes, _TEXT_OF_PLOT)
    axes.grid(color=FAINT, linewidth=0.4 * sizes.line, alpha=0.4)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=sizes.text, colors=INK, width=0.5 * sizes.line)
    for spine in axes.spines.values():
        spine.set(color=FAINT, linewidth=0.5 * sizes.line)
    if title is not None:
        write_title(axes, title, sizes)
    return sizes


def write_plainly(legend: Legend) -> None:
    """Let a dollar sign in the texts of a legend be a dollar sign."""
    for text in legend.get_texts():
        text.set_parse_math(False)


def name_axis(axes: Axes, sizes: Sizes, x: str, y: str) -> None:
    """Write what the two axes of a plot show, with units."""
    axes.set_xlabel(x, fontsize=sizes.text, color=INK, parse_math=False)
    axes.set_ylabel(y, fontsize=sizes.text, color=INK, parse_math=False)


def few_ticks(axes: Axes, sizes: Sizes) -> None:
    """Leave as many ticks as their labels have room for."""
    from matplotlib.ticker import MaxNLocator

    box = axes.get_window_extent()
    character = sizes.inch * axes.figure.dpi
    for axis, room in ((axes.xaxis, box.width / 6), (axes.yaxis, box.height / 3)):
        axis.set_major_locator(MaxNLocator(nbins=int(np.clip(room / character, 2, 8))))


def draw_bar(
    axes: Axes,
    ramp: NDArray[np.uint8],
    ticks: Sequence[tuple[float, str]],
    *,
    label: str,
    short: str,
    sizes: Sizes,
    below: bool,
) -> Axes:
    """Draw a bar of colours beside a picture or below it, within the room of its axes.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        The picture's, which gives the room.
    ramp : (N, 3) uint8 ndarray
        Colours from the least to the greatest value.
    ticks : sequence of (float, str)
        Shares of the bar, rising from 0 to 1, and what they stand for. The ends are written always,
        those between them where there is room.
    label : str
        What the bar shows, with its unit.
    short : str
        The same where there is room for little.
    sizes : Sizes
    below : bool
        Whether it lies below the picture.

    Returns
    -------
    matplotlib.axes.Axes
        Those of the bar.
    """
    longest = max(len(text) for _, text in ticks)
    character = _CHARACTER * sizes.inch
    width, height = _shown_size(axes)
    if below:
        bar = _room(axes, "bottom", 0.8 * sizes.inch, 0.6 * sizes.inch)
        _room(axes, "bottom", 3.2 * sizes.inch, 0).set_axis_off()
        bar.imshow(ramp[None], extent=(0, 1, 0, 1), aspect="auto", interpolation="bilinear")
        shown = with_room(ticks, 1.5 * (longest + 1) * character / width)
        bar.set_yticks([])
        bar.set_xticks([share for share, _ in shown], [text for _, text in shown])
        first, *_, last = bar.get_xticklabels()
        first.set_horizontalalignment("left")  # so that nothing is beyond the picture
        last.set_horizontalalignment("right")
        name = label if len(label) * character < width else short
        bar.set_xlabel(name, fontsize=sizes.text, color=INK, labelpad=2, parse_math=False)
    else:
        bar = _room(axes, "right", 0.8 * sizes.inch, 0.6 * sizes.inch)
        beside = longest * character + 2.6 * sizes.inch
        _room(axes, "right", beside, 0).set_axis_off()
        bar.imshow(ramp[::-1, None], extent=(0, 1, 0, 1), aspect="auto", interpolation="bilinear")
        left = max(width - beside - 1.4 * sizes.inch, 0.0) * height / width
        shown = with_room(ticks, 1.6 * sizes.inch / max(left, 1e-6))
        bar.yaxis.tick_right()
        bar.yaxis.set_label_position("right")
        bar.set_xticks([])
        bar.set_yticks([share for share, _ in shown], [text for _, text in shown])
        name = label if len(label) * character < min(height, left) else short
        bar.set_ylabel(name, fontsize=sizes.text, color=INK, labelpad=2, parse_math=False)
    bar.set(xlim=(0, 1), ylim=(0, 1))
    bar.tick_params(
        labelsize=sizes.text, colors=INK, pad=2, length=0.3 * sizes.text, width=0.5 * sizes.line
    )
    for spine in bar.spines.values():
        spine.set(color=FAINT, linewidth=0.5 * sizes.line)
    return bar


def _empty(axes: Axes) -> None:
    """Remove what was drawn into axes before, with its legend, and give them their place back."""
    place = getattr(axes, _PLACE, None)
    if place is not None:
        delattr(axes, _PLACE)
        for room in place.rooms:
            room.remove()
        axes.set_axes_locator(None)  # type: ignore[arg-type]
    axes.clear()
    is_laid_out = axes.get_in_layout()
    axes.reset_position()
    axes.set_in_layout(is_laid_out)  # which a position takes away


def legend_room(axes: Axes, width: float, gap: float) -> Axes:
    """Return empty axes beside a picture, so many inches wide, within the room of its axes."""
    room = _room(axes, "right", width, gap)
    room.set_axis_off()
    return room


def _room(axes: Axes, side: str, size: float, gap: float) -> Axes:
    """Return axes at a side of others, which give way: their position is found when drawn."""
    from mpl_toolkits.axes_grid1.axes_divider import make_axes_locatable

    place = getattr(axes, _PLACE, None)
    if place is None:
        place = _Place(divider=make_axes_locatable(axes))
        setattr(axes, _PLACE, place)
    room: Axes = place.divider.append_axes(side, size=size, pad=gap)
    place.rooms.append(room)
    return room


def _shown_size(axes: Axes) -> tuple[float, float]:
    """Return the width and height, inches, that a picture has in its axes without a legend."""
    box = axes.get_window_extent()
    width, height = max(box.width, 1.0) / axes.figure.dpi, max(box.height, 1.0) / axes.figure.dpi
    if axes.get_aspect() == "auto":
        return width, height
    columns, rows = (abs(end - start) for start, end in (axes.get_xlim(), axes.get_ylim()))
    return min(width, height * columns / rows), min(height, width * rows / columns)
