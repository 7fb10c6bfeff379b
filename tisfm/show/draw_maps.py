"""Depth, motion, labels, confidence and deviation of a frame, each with a legend, into axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.show.arrays import as_flow, as_map, check_limit
from tisfm.show.axes import (
    Sizes,
    draw_bar,
    legend_room,
    picture_axes,
    show_picture,
    write_plainly,
)
from tisfm.show.confidence import confidence_to_color
from tisfm.show.depth import depth_to_color, inverse_depth_limit
from tisfm.show.flow import color_wheel, flow_to_color, usual_length
from tisfm.show.labels import label_overlay
from tisfm.show.mosaic import WIDE
from tisfm.show.palette import FAINT, INK, Quantity, as_hex, color_ramp, colors_of_categories
from tisfm.show.ticks import depth_ticks, doublings
from tisfm.show.uncertainty import UNCERTAINTY_RANGE, uncertainty_to_color

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WHEEL_PIXELS = 400
_MOST_SWATCHES = 16  # labels beyond are counted


def draw_depth(
    inverse_depth: ArrayLike,
    *,
    axes: Axes | None = None,
    limit: float | None = None,
    unit: str = "relative",
    title: str | None = None,
) -> Axes:
    """Draw depth in the colours of `depth_to_color`, with a bar that says which depth they are.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth; grey where it is not finite.
    axes : matplotlib.axes.Axes, optional
        Where it is drawn; by default in a figure of its own, ``axes.figure``.
    limit : float, optional
        Inverse depth of the brightest colour, by default `inverse_depth_limit`.
    unit : str
        Unit of the depth, for the legend.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        What it was drawn into.

    Raises
    ------
    ValueError
        As `depth_to_color`.
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_depth, save_figure
    >>> axes = draw_depth(two_blocks(48, 64).inverse_depth, unit="m")  # a figure of its own
    >>> save_figure("depth.png", axes.figure, dpi=60)
    """
    values = as_map("inverse_depth", inverse_depth)
    top = inverse_depth_limit(values) if limit is None else check_limit("limit", limit)
    picture = depth_to_color(values, limit=top)
    label = f"depth Z ({unit})", f"Z ({unit})"
    return with_bar(picture, "depth", depth_ticks(top), label, axes, title)


def draw_flow(
    flow: ArrayLike,
    *,
    axes: Axes | None = None,
    limit: float | None = None,
    title: str | None = None,
) -> Axes:
    """Draw image motion in the colours of `flow_to_color`, with its wheel.

    The wheel is a convention of the Middlebury benchmark, so that pictures can be compared with
    those of others. Its hues are not even to the eye, nor all told apart without green or red
    cones: where that matters, draw errors and lengths (`draw_flow_error`, `flow_radius`).

    Parameters
    ----------
    flow : (H, W, 2) array_like
        Image motion, px/frame; black where it is not known.
    axes : matplotlib.axes.Axes, optional
        Where it is drawn; by default in a figure of its own, ``axes.figure``.
    limit : float, optional
        Motion at the rim of the wheel, px/frame, by default the 98th percentile of its length.
        Longer motion looks as if it were as long.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        What it was drawn into.

    Raises
    ------
    ValueError
        As `flow_to_color`.
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_flow, save_figure
    >>> figure = Figure()
    >>> axes = draw_flow(two_blocks(48, 64).flow, axes=figure.subplots(), title="Image motion")
    >>> save_figure("flow.png", figure, dpi=60)
    """
    values = as_flow("flow", flow)
    top = usual_length(values) if limit is None else check_limit("limit", limit)
    target = picture_axes(*values.shape[:2]) if axes is None else axes
    sizes = show_picture(target, flow_to_color(values, limit=top, beyond="same"), title)
    _draw_wheel(target, top, sizes)
    return target


def draw_confidence(
    confidence: ArrayLike, *, axes: Axes | None = None, title: str | None = None
) -> Axes:
    """Draw confidence in the colours of `confidence_to_color`, with a bar from 0 to 1.

    Parameters
    ----------
    confidence : (H, W) array_like
        In [0, 1]; grey where it is NaN.
    axes : matplotlib.axes.Axes, optional
        Where it is drawn; by default in a figure of its own, ``axes.figure``.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        What it was drawn into.

    Raises
    ------
    ValueError
        If `confidence` is not (H, W).
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import draw_confidence, save_figure
    >>> axes = draw_confidence(np.linspace(0, 1, 48 * 64).reshape(48, 64))
    >>> save_figure("confidence.png", axes.figure, dpi=60)
    """
    ticks = [(share, f"{share:g}") for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    picture = confidence_to_color(confidence)
    return with_bar(picture, "confidence", ticks, ("confidence (share)", "confidence"), axes, title)


def draw_uncertainty(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    *,
    axes: Axes | None = None,
    limits: tuple[float, float] = UNCERTAINTY_RANGE,
    title: str | None = None,
) -> Axes:
    """Draw the relative standard deviation of the depth, as `uncertainty_to_color` shows it.

    Parameters
    ----------
    inverse_depth, inverse_depth_std : (H, W) array_like
        Inverse depth and its standard deviation, in one unit; grey where one of them is not known.
    axes : matplotlib.axes.Axes, optional
        Where it is drawn; by default in a figure of its own, ``axes.figure``.
    limits : (float, float)
        Relative deviations at the two ends of the logarithmic scale.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        What it was drawn into.

    Raises
    ------
    ValueError
        As `uncertainty_to_color`.
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_uncertainty, save_figure
    >>> inverse_depth = two_blocks(48, 64).inverse_depth
    >>> axes = draw_uncertainty(inverse_depth, 0.05 * inverse_depth)
    >>> save_figure("deviation.png", axes.figure, dpi=60)
    """
    picture = uncertainty_to_color(inverse_depth, inverse_depth_std, limits=limits)
    ticks = doublings((100 * limits[0], 100 * limits[1]), "%")
    label = "standard deviation of depth (%)", "deviation (%)"
    return with_bar(picture, "error", ticks, label, axes, title)


def draw_labels(
    image: ArrayLike,
    labels: ArrayLike,
    *,
    axes: Axes | None = None,
    names: Sequence[str] = ("at rest",),
    title: str | None = None,
) -> Axes:
    """Draw labels over a picture, as `label_overlay` does, with a list of their colours.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture: uint8, uint16 or float.
    labels : (H, W) array_like of int
        Labels from 0.
    axes : matplotlib.axes.Axes, optional
        Where it is drawn; by default in a figure of its own, ``axes.figure``.
    names : sequence of str
        Names of the first labels; the others are called by their numbers.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        What it was drawn into.

    Raises
    ------
    TypeError, ValueError
        As `label_overlay`.
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_labels, save_figure
    >>> scene = two_blocks(48, 64)
    >>> names = ["wall", "floor", "large block", "small block"]
    >>> axes = draw_labels(scene.frame0, scene.labels, names=names)
    >>> save_figure("labels.png", axes.figure, dpi=60)
    """
    picture = label_overlay(image, labels)
    found = [int(label) for label in np.unique(np.asarray(labels))]
    target = picture_axes(*picture.shape[:2]) if axes is None else axes
    sizes = show_picture(target, picture, title)
    texts = [names[k] if k < len(names) else str(k) for k in found[:_MOST_SWATCHES]]
    if len(found) > _MOST_SWATCHES:
        texts.append(f"{len(found) - _MOST_SWATCHES} more")
    room = legend_room(target, (0.65 * max(map(len, texts)) + 2.2) * sizes.inch, 0.5 * sizes.inch)
    colors = colors_of_categories(np.array(found))
    from matplotlib.patches import Patch

    patches = [
        Patch(facecolor=as_hex(colors[k]), edgecolor=FAINT, linewidth=0.5 * sizes.line)
        if k < _MOST_SWATCHES
        else Patch(facecolor="none", edgecolor="none")
        for k in range(len(texts))
    ]
    legend = room.legend(
        patches,
        texts,
        loc="center left",
        borderaxespad=0,
        borderpad=0,
        frameon=False,
        fontsize=sizes.text,
        labelcolor=INK,
        handlelength=1.0,
        handleheight=1.0,
        handletextpad=0.5,
        labelspacing=0.3,
    )
    write_plainly(legend)
    return target


def with_bar(
    picture: NDArray[np.uint8],
    quantity: Quantity,
    ticks: Sequence[tuple[float, str]],
    label: tuple[str, str],
    axes: Axes | None,
    title: str | None,
) -> Axes:
    """Draw a picture with the bar of its colours, whose label is long or short."""
    height, width = picture.shape[:2]
    below = width >= WIDE * height
    target = picture_axes(height, width, below=below) if axes is None else axes
    sizes = show_picture(target, picture, title)
    draw_bar(
        target,
        color_ramp(quantity),
        ticks,
        label=label[0],
        short=label[1],
        sizes=sizes,
        below=below,
    )
    return target


def _draw_wheel(axes: Axes, limit: float, sizes: Sizes) -> None:
    """Draw the wheel of colours beside a picture, and what its rim stands for."""
    box = axes.get_window_extent()
    height, width = (side / axes.figure.dpi for side in (box.height, box.width))
    rim = f"{limit:.0f}" if limit >= 100 else f"{limit:.2g}"
    texts = [f"rim: ≥ {rim}", "px/frame"]
    diameter = min(0.2 * width, max(0.6 * height, 2.0 * sizes.inch))
    wide = max(diameter, 0.62 * max(map(len, texts)) * sizes.inch)
    room = legend_room(axes, wide, 0.5 * sizes.inch)
    wheel = room.inset_axes((0.0, 0.3, 1.0, 0.7))
    wheel.imshow(color_wheel(_WHEEL_PIXELS), aspect="equal", interpolation="antialiased")
    wheel.set_anchor("S")
    wheel.set_axis_off()
    room.text(
        0.5,
        0.28,
        "\n".join(texts),
        transform=room.transAxes,
        ha="center",
        va="top",
        fontsize=sizes.text,
        color=INK,
    )
