"""Figures of several panels, such as the paper's: depth and motion beside a baseline and the truth.

Importing this module is fast: Matplotlib is imported when the first figure is drawn.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import unmasked_mask
from tisfm.errors import InputError
from tisfm.formats import atomic_write
from tisfm.show.arrays import (
    as_flow,
    as_image,
    as_map,
    as_rgb,
    as_uint8,
    check_limit,
    require_same_size,
)
from tisfm.show.depth import depth_grey, inverse_depth_limit
from tisfm.show.flow import flow_to_color, usual_length
from tisfm.show.legends import (
    DEPTH_BAR_SIZE,
    LEGEND_SIZE,
    backdrop,
    draw_arrows,
    draw_depth_bar,
    draw_legend,
    draw_panels,
)
from tisfm.show.mosaic import beside_legends, beside_size, panel_size
from tisfm.show.palette import HIDDEN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NAMES = {
    "frame": "Frame",
    "occlusion": "Frame (red: not visible in the next)",
    "depth": "Recovered depth (near is bright)",
    "truth_depth": "True depth (near is bright)",
    "flow": "Recovered flow (eq. 25)",
    "baseline": "Horn–Schunck flow",
    "truth": "True flow",
}
_SUFFIXES = (".jpeg", ".jpg", ".pdf", ".png", ".svg", ".tif", ".tiff")
# Without these a file states when it was made, and two runs never make the same file.
_UNDATED = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
_PLEASANT_RATIO = 1.6


def comparison_figure(
    frame: ArrayLike,
    inverse_depth: ArrayLike,
    flow: ArrayLike,
    *,
    occlusion: ArrayLike | None = None,
    baseline_flow: ArrayLike | None = None,
    truth_flow: ArrayLike | None = None,
    truth_inverse_depth: ArrayLike | None = None,
    title: str | None = None,
    names: Mapping[str, str] | None = None,
    depth_limit: float | None = None,
    flow_limit: float | None = None,
    unit: str = "relative",
) -> Figure:
    """Show a frame, its depth and its motion, beside a baseline and the truth where there are any.

    The first row has the frame and the depth as grey levels. Below it each flow is shown as arrows
    over the frame and as colours, side by side, all with one scale of the arrows and one range of
    the colours.

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) array_like
        The first frame: uint8, uint16 or float.
    inverse_depth : (H, W) array_like
        Recovered inverse depth in any unit.
    flow : (H, W, 2) array_like
        Recovered flow (eq. 25), px/frame.
    occlusion : (H, W) array_like, optional
        Nonzero where a pixel is not visible in the next frame: red in the first panel.
    baseline_flow, truth_flow : (H, W, 2) array_like, optional
        Flow of the Horn-Schunck method, and true flow, px/frame. Unknown are NaN and values
        beyond 1e9.
    truth_inverse_depth : (H, W) array_like, optional
        True inverse depth. Its unit is its own, and so is its range.
    title : str, optional
        Heading of the figure.
    names : mapping, optional
        Other titles of panels, for any of the keys "frame", "occlusion" (of the frame where
        occlusion is given), "depth", "truth_depth", "flow",
        "baseline" and "truth".
    depth_limit : float, optional
        Recovered inverse depth shown as white, by default its 95th percentile.
    flow_limit : float, optional
        Motion at the rim of the colour wheel, px/frame, by default the 98th percentile of the
        length of the true flow, or else of the recovered one. No arrow is longer than three times
        this. Give all figures of a sequence the same limits.
    unit : str
        Unit of the recovered depth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, for `save_figure`.

    Raises
    ------
    ValueError
        If a shape is wrong, sizes differ, a value is masked, a limit is negative or not finite,
        or `names` has another key.
    ImportError
        If Matplotlib is not installed.

    References
    ----------
    H. Sekkati and A. Mitiche, Robotics and Autonomous Systems 55 (2007) 597-607, Fig. 3 to 8,
    doi:10.1016/j.robot.2006.11.006.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import comparison_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> figure = comparison_figure(scene.frame0, scene.inverse_depth, scene.flow)
    >>> save_figure("figure.png", figure, dpi=60)
    """
    labels = _labels(names)
    picture = as_image("frame", frame)
    depths = {"inverse_depth": as_map("inverse_depth", inverse_depth)}
    if truth_inverse_depth is not None:
        depths["truth_inverse_depth"] = as_map("truth_inverse_depth", truth_inverse_depth)
    flows = {"flow": as_flow("flow", flow)}
    if baseline_flow is not None:
        flows["baseline_flow"] = as_flow("baseline_flow", baseline_flow)
    if truth_flow is not None:
        flows["truth_flow"] = as_flow("truth_flow", truth_flow)
    hidden = None if occlusion is None else unmasked_mask(occlusion, "occlusion")
    masks = {} if hidden is None else {"occlusion": hidden}
    for name, array in (*depths.items(), *flows.items(), *masks.items()):
        require_same_size(name, array, "frame", picture)
    if flow_limit is None:
        limit = usual_length(flows.get("truth_flow", flows["flow"]))
    else:
        limit = check_limit("flow_limit", flow_limit)

    nearest = (
        inverse_depth_limit(depths["inverse_depth"])
        if depth_limit is None
        else check_limit("depth_limit", depth_limit)
    )
    scales = {f"depth Z\n({unit})": nearest}

    (shown,) = as_uint8(picture)
    first = [
        (labels["frame"], shown) if hidden is None else (labels["occlusion"], tint(shown, hidden)),
        (labels["depth"], depth_grey(depths["inverse_depth"], limit=nearest)),
    ]
    if "truth_inverse_depth" in depths:
        first.append((labels["truth_depth"], depth_grey(depths["truth_inverse_depth"])))
        scales["true Z\n(its unit)"] = inverse_depth_limit(depths["truth_inverse_depth"])
    flow_labels = {name: labels[name.removesuffix("_flow")] for name in flows}
    dim = backdrop(shown)
    arrows = [(f"{label}, arrows", dim) for label in flow_labels.values()]
    colors = [
        (f"{label}, colours", flow_to_color(flows[name], limit=limit, beyond="same"))
        for name, label in flow_labels.items()
    ]
    # A single flow has its arrows and colours side by side as well.
    below = [arrows + colors] if len(flows) == 1 else [arrows, colors]
    legends = [DEPTH_BAR_SIZE] * len(scales) + [LEGEND_SIZE]
    figure, axes, layout = draw_panels([first, *below], heading=title, legend=beside_size(legends))
    for panel, values in zip(axes[len(first) :], flows.values(), strict=False):
        draw_arrows(panel, values, limit)
    *of_depth, wheel = beside_legends(layout, legends)
    greys = as_rgb(np.arange(256, dtype=np.uint8)[:, None])[:, 0]
    for room, (label, top) in zip(of_depth, scales.items(), strict=True):
        draw_depth_bar(figure, room, greys, top, label=label)
    draw_legend(figure, wheel, (picture.shape[0], picture.shape[1]), limit)
    return figure


def panel_figure(
    panels: Sequence[tuple[str, ArrayLike]],
    *,
    columns: int | None = None,
    title: str | None = None,
) -> Figure:
    """Show pictures side by side, such as the depth at two settings (Fig. 6 and 8 of the paper).

    Parameters
    ----------
    panels : sequence of (str, array_like)
        Titles and pictures, (H, W) or (H, W, 3), uint8, uint16 or float. Sizes may differ. Floats
        are brought to grey levels one picture at a time: to compare two depths, make both by
        `depth_grey` with one limit.
    columns : int, optional
        Pictures in a row. The default is what makes the figure about 1.6 times as wide as high,
        two or three pictures always being side by side.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, for `save_figure`.

    Raises
    ------
    ValueError
        If there are no panels, a shape is wrong, or `columns` is less than 1.
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import panel_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> figure = panel_figure([("before", scene.frame0), ("after", scene.frame1)])
    >>> save_figure("panels.png", figure, dpi=60)
    """
    shown = [(name, as_uint8(as_image(f"panel {name!r}", image))[0]) for name, image in panels]
    if not shown:
        raise InputError("panels is empty, expected at least one (title, picture)")
    if columns is None:
        columns = _pleasant_columns([image for _, image in shown])
    if columns < 1:
        raise InputError(f"columns is {columns}, expected 1 or more")
    rows = [shown[first : first + columns] for first in range(0, len(shown), columns)]
    return draw_panels(rows, heading=title)[0]


def save_figure(path: str | os.PathLike[str], figure: Figure, dpi: float = 150) -> None:
    """Save a figure, whole or not at all, in the format that the suffix names.

    Parameters
    ----------
    path : str or os.PathLike
        File to write: .png, .jpg, .tif, .pdf or .svg.
    figure : matplotlib.figure.Figure
        Figure to save.
    dpi : float
        Pixels per inch.

    Raises
    ------
    ValueError
        If the suffix is none of these or `dpi` is not positive.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import panel_figure, save_figure
    >>> save_figure("panel.png", panel_figure([("frame", two_blocks(48, 64).frame0)]), dpi=60)
    """
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in _SUFFIXES:
        raise InputError(
            f"{os.fspath(path)} has the suffix {suffix!r}, expected one of {', '.join(_SUFFIXES)}"
        )
    if not (math.isfinite(dpi) and dpi > 0):
        raise InputError(f"dpi is {dpi!r}, expected a finite positive number")
    with atomic_write(path) as file:
        figure.savefig(file, format=suffix[1:], dpi=dpi, metadata=_UNDATED.get(suffix))


def tint(image: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a picture in colour, red where the mask is set, with a third of itself kept.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8 ndarray
    mask : (H, W) bool ndarray

    Returns
    -------
    (H, W, 3) uint8 ndarray
    """
    tinted = np.dstack([image] * 3) if image.ndim == 2 else image.copy()
    red = (tinted[mask].astype(np.uint16) + 2 * np.array(HIDDEN, np.uint16)) // 3
    tinted[mask] = red.astype(np.uint8)
    return tinted


def _labels(names: Mapping[str, str] | None) -> dict[str, str]:
    """Return the titles of the panels, some of them replaced."""
    changes = dict(names or {})
    unknown = sorted(set(changes) - set(_NAMES))
    if unknown:
        raise InputError(f"names has {', '.join(unknown)}, expected any of {', '.join(_NAMES)}")
    return {**_NAMES, **changes}


def _pleasant_columns(images: Sequence[NDArray[np.uint8]]) -> int:
    """Return the number of columns that gives a figure of a pleasant shape."""
    count = len(images)
    if count <= 3:
        return count
    width, height = np.mean([panel_size(*image.shape[:2]) for image in images], axis=0)
    shapes = {
        columns: columns * width / (math.ceil(count / columns) * height)
        for columns in range(1, count + 1)
    }
    return min(shapes, key=lambda columns: abs(math.log(shapes[columns] / _PLEASANT_RATIO)))
