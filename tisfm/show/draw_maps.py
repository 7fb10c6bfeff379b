"""Draw depth, labels, confidence and deviation of a frame, each with a legend, into axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_mask
from tisfm.show.arrays import as_image, as_map, as_uint8, check_limit, require_same_size
from tisfm.show.axes import disable_formulas, draw_bar, legend_axes, picture_axes, show_picture
from tisfm.show.color_maps import (
    UNCERTAINTY_RANGE,
    confidence_to_color,
    depth_grey,
    depth_to_color,
    inverse_depth_limit,
    uncertainty_to_color,
)
from tisfm.show.labels import label_overlay
from tisfm.show.mosaic import MIN_WIDE_RATIO
from tisfm.show.palette import (
    GRID_COLOR,
    OCCLUSION_COLOR,
    TEXT_COLOR,
    as_hex,
    color_ramp,
    colors_of_categories,
)
from tisfm.show.ticks import depth_ticks, doubling_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GREY_RAMP = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)  # far to near
_MAX_LABELS = 16  # labels in a legend; further labels are only counted; set by hand


def draw_image(
    image: ArrayLike,
    *,
    axes: Axes | None = None,
    hidden: ArrayLike | None = None,
    title: str | None = None,
) -> Axes:
    """Draw a picture, and tint the pixels of a mask red.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture: uint8, uint16 or float.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    hidden : (H, W) array_like, optional
        Nonzero for pixels to tint, such as pixels that are not visible in the next frame.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    ValueError
        If a shape is wrong, or sizes differ.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_image, save_figure
    >>> scene = two_blocks(48, 64)
    >>> axes = draw_image(scene.frame0, hidden=scene.labels == 3)
    >>> save_figure("frame.png", axes.figure, dpi=60)
    """
    (picture,) = as_uint8(as_image("image", image))
    if hidden is not None:
        mask = check_mask(hidden, "hidden")
        require_same_size("hidden", mask, "image", picture)
        picture = _tint(picture, mask)
    target = picture_axes(*picture.shape[:2]) if axes is None else axes
    show_picture(target, picture, title)
    return target


def draw_depth(
    inverse_depth: ArrayLike,
    *,
    axes: Axes | None = None,
    limit: float | None = None,
    unit: str = "relative",
    grey: bool = False,
    legend: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw depth in the colours of `depth_to_color`, with a bar of colours labelled by depths.

    Parameters
    ----------
    inverse_depth : (H, W) array_like
        Inverse depth; unknown pixels, which are not finite, are grey.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    limit : float, optional
        Inverse depth of the brightest colour, by default `inverse_depth_limit`.
    unit : str
        Unit of the depth, for the legend.
    grey : bool
        Whether to use the grey levels of `depth_grey`, as the paper does, in place of colours.
    legend : bool
        Whether to draw the legend.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    ValueError
        As `depth_to_color`.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_depth, save_figure
    >>> axes = draw_depth(two_blocks(48, 64).inverse_depth, unit="m")  # a figure of its own
    >>> save_figure("depth.png", axes.figure, dpi=60)
    """
    values = as_map("inverse_depth", inverse_depth)
    max_inverse_depth = (
        inverse_depth_limit(values) if limit is None else check_limit("limit", limit)
    )
    label = f"depth Z ({unit})", f"Z ({unit})"
    bar = Bar(
        ramp=GREY_RAMP if grey else color_ramp("depth"),
        ticks=depth_ticks(max_inverse_depth),
        label=label,
    )
    picture = (
        depth_grey(values, limit=max_inverse_depth)
        if grey
        else depth_to_color(values, limit=max_inverse_depth)
    )
    return draw_with_bar(picture, bar if legend else None, axes, title)


def draw_confidence(
    confidence: ArrayLike,
    *,
    axes: Axes | None = None,
    legend: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw confidence in the colours of `confidence_to_color`, with a bar from 0 to 1.

    Parameters
    ----------
    confidence : (H, W) array_like
        In [0, 1]; NaN is grey.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    legend : bool
        Whether to draw the legend.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    ValueError
        If `confidence` is not (H, W).

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import draw_confidence, save_figure
    >>> axes = draw_confidence(np.linspace(0, 1, 48 * 64).reshape(48, 64))
    >>> save_figure("confidence.png", axes.figure, dpi=60)
    """
    ticks = [(share, f"{share:g}") for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    label = "confidence (share)", "confidence"
    bar = Bar(ramp=color_ramp("confidence"), ticks=ticks, label=label)
    return draw_with_bar(confidence_to_color(confidence), bar if legend else None, axes, title)


def draw_uncertainty(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    *,
    axes: Axes | None = None,
    limits: tuple[float, float] = UNCERTAINTY_RANGE,
    legend: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw the relative standard deviation of the depth in the colours of `uncertainty_to_color`.

    Parameters
    ----------
    inverse_depth, inverse_depth_std : (H, W) array_like
        Inverse depth and its standard deviation, in one unit. A pixel is grey if either is unknown.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    limits : (float, float)
        Relative deviations at the two ends of the logarithmic scale.
    legend : bool
        Whether to draw the legend.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    ValueError
        As `uncertainty_to_color`.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_uncertainty, save_figure
    >>> inverse_depth = two_blocks(48, 64).inverse_depth
    >>> axes = draw_uncertainty(inverse_depth, 0.05 * inverse_depth)
    >>> save_figure("deviation.png", axes.figure, dpi=60)
    """
    picture = uncertainty_to_color(inverse_depth, inverse_depth_std, limits=limits)
    ticks = doubling_ticks((100 * limits[0], 100 * limits[1]), "%")
    label = "standard deviation of depth (%)", "deviation (%)"
    bar = Bar(ramp=color_ramp("error"), ticks=ticks, label=label)
    return draw_with_bar(picture, bar if legend else None, axes, title)


def draw_labels(
    image: ArrayLike,
    labels: ArrayLike,
    *,
    axes: Axes | None = None,
    names: Sequence[str] = ("at rest",),
    legend: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw labels over a picture, as `label_overlay` does, with a legend of their colours.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture: uint8, uint16 or float.
    labels : (H, W) array_like of int
        Labels from 0.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    names : sequence of str
        Names of the first labels; the legend has numbers for the others.
    legend : bool
        Whether to draw the legend.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    TypeError, ValueError
        As `label_overlay`.

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
    present_labels = [int(label) for label in np.unique(np.asarray(labels))]
    target = picture_axes(*picture.shape[:2]) if axes is None else axes
    sizes = show_picture(target, picture, title)
    if not legend:
        return target
    texts = [names[k] if k < len(names) else str(k) for k in present_labels[:_MAX_LABELS]]
    if len(present_labels) > _MAX_LABELS:
        texts.append(f"{len(present_labels) - _MAX_LABELS} more")
    space = legend_axes(
        target, (0.65 * max(map(len, texts)) + 2.2) * sizes.text_inches, 0.5 * sizes.text_inches
    )
    colors = colors_of_categories(np.array(present_labels))
    from matplotlib.patches import Patch

    patches = [
        Patch(facecolor=as_hex(colors[k]), edgecolor=GRID_COLOR, linewidth=0.5 * sizes.line)
        if k < _MAX_LABELS
        else Patch(facecolor="none", edgecolor="none")
        for k in range(len(texts))
    ]
    label_list = space.legend(
        patches,
        texts,
        loc="center left",
        borderaxespad=0,
        borderpad=0,
        frameon=False,
        fontsize=sizes.text,
        labelcolor=TEXT_COLOR,
        handlelength=1.0,
        handleheight=1.0,
        handletextpad=0.5,
        labelspacing=0.3,
    )
    disable_formulas(label_list)
    return target


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A bar of colours beside or below a picture."""

    ramp: NDArray[np.uint8]  # (N, 3) uint8: colours from the smallest to the largest value
    # sequence of (float, str): positions along the bar, from 0 to 1, and their labels
    ticks: Sequence[tuple[float, str]]
    label: tuple[str, str]  # (str, str): quantity and unit, in a long and a short form


def draw_with_bar(
    picture: NDArray[np.uint8], bar: Bar | None, axes: Axes | None, title: str | None
) -> Axes:
    """Draw a picture, with a bar of its colours unless `bar` is None."""
    height, width = picture.shape[:2]
    is_below = width >= MIN_WIDE_RATIO * height
    target = picture_axes(height, width, legend_below=is_below) if axes is None else axes
    sizes = show_picture(target, picture, title)
    if bar is not None:
        label, short_label = bar.label
        draw_bar(
            target,
            bar.ramp,
            bar.ticks,
            label=label,
            short_label=short_label,
            sizes=sizes,
            is_below=is_below,
        )
    return target


def _tint(image: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a picture in colour whose masked pixels are two thirds red."""
    tinted = np.dstack([image] * 3) if image.ndim == 2 else image.copy()
    mixture = (tinted[mask].astype(np.uint16) + 2 * np.array(OCCLUSION_COLOR, np.uint16)) // 3
    tinted[mask] = mixture.astype(np.uint8)
    return tinted
