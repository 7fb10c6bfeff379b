"""Figures of a pair: depth and motion beside a baseline, the truth, uncertainty and confidence.

Each figure is a mosaic of panels that the ``draw_…`` functions draw. Matplotlib is imported when
the first figure is drawn.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_mask, refuse_masked
from tisfm.errors import InputError
from tisfm.formats import atomic_write
from tisfm.show.arrays import as_flow, as_image, as_map, as_uint8, check_limit, require_same_size
from tisfm.show.axes import show_picture
from tisfm.show.color_maps import UNCERTAINTY_RANGE, inverse_depth_limit
from tisfm.show.draw_flow import draw_arrows, draw_flow
from tisfm.show.draw_maps import (
    GREY_RAMP,
    draw_confidence,
    draw_depth,
    draw_image,
    draw_labels,
    draw_uncertainty,
)
from tisfm.show.flow import usual_length
from tisfm.show.legends import depth_legend, error_legend, flow_legend, label_legend
from tisfm.show.mosaic import MIN_WIDE_RATIO, Panel, join_legends, mosaic, panel_size, stack_legends

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TITLES = {
    "frame": "Frame",
    "occlusion": "Frame (red: not visible in the next)",
    "depth": "Recovered depth (near is bright)",
    "truth_depth": "True depth (near is bright)",
    "flow": "Recovered flow (eq. 25)",
    "baseline": "Horn–Schunck flow",
    "truth": "True flow",
}
_SUFFIXES = (".jpeg", ".jpg", ".pdf", ".png", ".svg", ".tif", ".tiff")
# Without these entries, a file contains its time, and every run writes a different file.
_METADATA_WITHOUT_DATES = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
_PANEL_FIGURE_RATIO = 1.6  # width over height of a figure of panels; set by hand


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
    """Show a frame, its depth and its motion, beside a baseline and the truth if these are given.

    The first row has the frame and the depth as grey levels. Below it each flow is shown as arrows
    over the frame and as colours. All flows share one scale of arrows and one range of colours.

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) array_like
        The first frame: uint8, uint16 or float.
    inverse_depth : (H, W) array_like
        Recovered inverse depth in any unit.
    flow : (H, W, 2) array_like
        Recovered flow (eq. 25), px/frame.
    occlusion : (H, W) array_like, optional
        Nonzero for pixels that are not visible in the next frame: red in the first panel.
    baseline_flow, truth_flow : (H, W, 2) array_like, optional
        Flow of the Horn-Schunck method, and true flow, px/frame. NaN and values beyond 1e9 are
        unknown.
    truth_inverse_depth : (H, W) array_like, optional
        True inverse depth, in its own unit, shown with its own range.
    title : str, optional
        Heading of the figure.
    names : mapping, optional
        Titles that replace default titles of panels, by the keys "frame", "occlusion" (the frame,
        if `occlusion` is given), "depth", "truth_depth", "flow", "baseline" and "truth".
    depth_limit : float, optional
        Recovered inverse depth shown as white, by default its 95th percentile.
    flow_limit : float, optional
        Motion at the rim of the colour wheel, px/frame, by default the 98th percentile of the
        length of the true flow, or else of the recovered flow. No arrow is longer than three times
        the limit. Give all figures of a sequence the same limits.
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
    titles = _titles(names)
    picture = as_image("frame", frame)
    depth = as_map("inverse_depth", inverse_depth)
    flows = {"flow": as_flow("flow", flow)}
    if baseline_flow is not None:
        flows["baseline"] = as_flow("baseline_flow", baseline_flow)
    if truth_flow is not None:
        flows["truth"] = as_flow("truth_flow", truth_flow)
    true_depth = _optional_map("truth_inverse_depth", truth_inverse_depth)
    hidden_mask = None if occlusion is None else check_mask(occlusion, "occlusion")
    arrays = {
        "inverse_depth": depth,
        "truth_inverse_depth": true_depth,
        **{name if name == "flow" else f"{name}_flow": values for name, values in flows.items()},
        "occlusion": hidden_mask,
    }
    _require_frame_size(picture, arrays)
    limit = _flow_limit(flow_limit, flows.get("truth", flows["flow"]))
    max_inverse_depth = _depth_limit(depth_limit, depth)
    shape = (picture.shape[0], picture.shape[1])

    first_row = [
        Panel(
            title=titles["frame" if hidden_mask is None else "occlusion"],
            shape=shape,
            draw=lambda axes: draw_image(picture, hidden=hidden_mask, axes=axes),
        ),
        _depth_panel(titles["depth"], depth, max_inverse_depth, grey=True),
    ]
    bars = [depth_legend(max_inverse_depth, f"depth Z\n({unit})", ramp=GREY_RAMP)]
    if true_depth is not None:
        true_max_inverse_depth = inverse_depth_limit(true_depth)
        first_row.append(
            _depth_panel(titles["truth_depth"], true_depth, true_max_inverse_depth, grey=True)
        )
        bars.append(depth_legend(true_max_inverse_depth, "true Z\n(its unit)", ramp=GREY_RAMP))
    arrows = [
        _arrow_panel(f"{titles[name]}, arrows", picture, values, limit)
        for name, values in flows.items()
    ]
    colors = [
        _flow_panel(f"{titles[name]}, colours", values, limit) for name, values in flows.items()
    ]
    # A single flow has its arrows and colours side by side, like several flows.
    flow_rows = [arrows + colors] if len(flows) == 1 else [arrows, colors]
    legend = join_legends([*bars, flow_legend(shape, limit)])
    return mosaic([first_row, *flow_rows], heading=title, legend=legend)


def rigid_figure(
    frame: ArrayLike,
    inverse_depth: ArrayLike,
    flow: ArrayLike,
    *,
    inverse_depth_std: ArrayLike,
    confidence: ArrayLike,
    labels: ArrayLike | None = None,
    occlusion: ArrayLike | None = None,
    truth_flow: ArrayLike | None = None,
    truth_inverse_depth: ArrayLike | None = None,
    title: str | None = None,
    depth_limit: float | None = None,
    flow_limit: float | None = None,
    unit: str = "relative",
) -> Figure:
    """Show the depth of rigid motions with its uncertainty, and the motion with its confidence.

    The first row has the frame, the labels if there are several, the depth in the colours of
    `depth_to_color`, the true depth if it is known, and the relative standard deviation of the
    depth of pixels that are visible in the next frame. The second row has the flow as arrows and as
    colours, the true flow if it is known, and the confidence. Wide pictures stand two in a row, in
    the same order.

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) array_like
        The first frame: uint8, uint16 or float.
    inverse_depth, inverse_depth_std : (H, W) array_like
        Inverse depth in any unit and its standard deviation. A pixel whose inverse depth is not
        positive has no depth.
    flow : (H, W, 2) array_like
        Image motion, px/frame.
    confidence : (H, W) array_like
        In [0, 1].
    labels : (H, W) array_like of int, optional
        The motion of each pixel by its number; 0 is the background.
    occlusion : (H, W) array_like, optional
        Nonzero for pixels that are not visible in the next frame: red in the first panel.
    truth_flow : (H, W, 2) array_like, optional
        True flow, px/frame. NaN and values beyond 1e9 are unknown.
    truth_inverse_depth : (H, W) array_like, optional
        True inverse depth, in its own unit, shown with its own range.
    title : str, optional
        Heading of the figure.
    depth_limit, flow_limit : float, optional
        As for `comparison_figure`.
    unit : str
        Unit of the depth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, for `save_figure`.

    Raises
    ------
    TypeError, ValueError
        If a shape or type is wrong, sizes differ, a value is masked, or a limit is negative or not
        finite.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.scenes import static_scene
    >>> from tisfm.show import rigid_figure, save_figure
    >>> scene = static_scene("sideways", 48, 64)
    >>> figure = rigid_figure(
    ...     scene.frame0,
    ...     scene.inverse_depth,
    ...     scene.flow,
    ...     inverse_depth_std=0.05 * scene.inverse_depth,
    ...     confidence=np.ones((48, 64)),
    ... )
    >>> save_figure("figure.png", figure, dpi=60)
    """
    picture = as_image("frame", frame)
    depth = as_map("inverse_depth", inverse_depth)
    deviation = as_map("inverse_depth_std", inverse_depth_std)
    image_flow, confidence_map = as_flow("flow", flow), as_map("confidence", confidence)
    true_flow = None if truth_flow is None else as_flow("truth_flow", truth_flow)
    true_depth = _optional_map("truth_inverse_depth", truth_inverse_depth)
    hidden_mask = None if occlusion is None else check_mask(occlusion, "occlusion")
    refuse_masked(labels, "labels", "fill them first, for instance by labels.filled(0)")
    arrays = {
        "inverse_depth": depth,
        "inverse_depth_std": deviation,
        "flow": image_flow,
        "confidence": confidence_map,
        "truth_flow": true_flow,
        "truth_inverse_depth": true_depth,
        "occlusion": hidden_mask,
    }
    _require_frame_size(picture, arrays)
    limit = _flow_limit(flow_limit, image_flow if true_flow is None else true_flow)
    max_inverse_depth = _depth_limit(depth_limit, depth)
    shape = (picture.shape[0], picture.shape[1])
    numbers = [0] if labels is None else [int(label) for label in np.unique(labels)]

    first_row = [
        Panel(
            title=_TITLES["frame" if hidden_mask is None else "occlusion"],
            shape=shape,
            draw=lambda axes: draw_image(picture, hidden=hidden_mask, axes=axes),
        )
    ]
    legends = []
    if labels is not None and numbers[-1] > 0:
        draw = partial(draw_labels, picture, labels)
        first_row.append(
            Panel(title="Motions", shape=shape, draw=lambda axes: draw(axes=axes, legend=False))
        )
        names = ["0, background" if label == 0 else str(label) for label in numbers]
        legends.append(label_legend(numbers, names))
    depth_title = "Depth (near is bright)" if (depth > 0).any() else "Depth: no pixel has a depth"
    first_row.append(_depth_panel(depth_title, depth, max_inverse_depth))
    bars = [depth_legend(max_inverse_depth, f"depth Z\n({unit})")]
    if true_depth is not None:
        true_max_inverse_depth = inverse_depth_limit(true_depth)
        first_row.append(_depth_panel(_TITLES["truth_depth"], true_depth, true_max_inverse_depth))
        bars.append(depth_legend(true_max_inverse_depth, "true Z\n(its unit)"))
    if hidden_mask is not None:  # the deviation holds for visible pixels only
        deviation = np.where(hidden_mask, np.inf, deviation)
    first_row.append(
        Panel(
            title="Uncertainty of the depth (grey: unknown)",
            shape=shape,
            draw=lambda axes: draw_uncertainty(depth, deviation, axes=axes, legend=False),
        )
    )
    second_row = [
        _arrow_panel("Flow, arrows", picture, image_flow, limit),
        _flow_panel("Flow, colours", image_flow, limit),
    ]
    if true_flow is not None:
        second_row.append(_flow_panel("True flow, colours", true_flow, limit))
    second_row.append(
        Panel(
            title="Confidence (yellow: 1)",
            shape=shape,
            draw=lambda axes: draw_confidence(confidence_map, axes=axes, legend=False),
        )
    )
    rows = [first_row, second_row]
    if shape[1] >= MIN_WIDE_RATIO * shape[0]:
        panels = first_row + second_row
        rows = [panels[k : k + 2] for k in range(0, len(panels), 2)]
    low, high = UNCERTAINTY_RANGE
    bars.append(error_legend((100 * low, 100 * high), "%"))
    legend = stack_legends([*legends, join_legends(bars), flow_legend(shape, limit)])
    return mosaic(rows, heading=title, legend=legend)


def panel_figure(
    panels: Sequence[tuple[str, ArrayLike]], *, columns: int | None = None, title: str | None = None
) -> Figure:
    """Show pictures side by side, such as depths with two settings (Fig. 6 and 8 of the paper).

    Parameters
    ----------
    panels : sequence of (str, array_like)
        Titles and pictures, (H, W) or (H, W, 3), uint8, uint16 or float. Sizes may differ. Floats
        of each picture are converted to grey levels separately: to compare two depths, convert both
        by `depth_grey` with the same limit.
    columns : int, optional
        Pictures in a row. By default the figure is about 1.6 times as wide as high; two or three
        pictures are always side by side.
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

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import panel_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> figure = panel_figure([("before", scene.frame0), ("after", scene.frame1)])
    >>> save_figure("panels.png", figure, dpi=60)
    """
    images = [(name, as_uint8(as_image(f"panel {name!r}", image))[0]) for name, image in panels]
    if not images:
        raise InputError("panels is empty, expected at least one (title, picture)")
    if columns is None:
        columns = _default_columns([image for _, image in images])
    if columns < 1:
        raise InputError(f"columns is {columns}, expected 1 or more")
    titled_panels = [
        Panel(title=name, shape=image.shape[:2], draw=partial(show_picture, image=image))
        for name, image in images
    ]
    rows = [
        titled_panels[first : first + columns] for first in range(0, len(titled_panels), columns)
    ]
    return mosaic(rows, heading=title)


def save_figure(path: str | os.PathLike[str], figure: Figure, dpi: float = 150) -> None:
    """Save a figure in the format of the suffix. A failed save leaves no partial file.

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
        If the suffix is unknown or `dpi` is not positive.
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
        figure.savefig(
            file, format=suffix[1:], dpi=dpi, metadata=_METADATA_WITHOUT_DATES.get(suffix)
        )


def _depth_panel(
    title: str, inverse_depth: NDArray[np.floating], limit: float, *, grey: bool = False
) -> Panel:
    draw = partial(draw_depth, inverse_depth, limit=limit, grey=grey, legend=False)
    height, width = inverse_depth.shape
    return Panel(title=title, shape=(height, width), draw=lambda axes: draw(axes=axes))


def _flow_panel(title: str, flow: NDArray[np.floating], limit: float) -> Panel:
    draw = partial(draw_flow, flow, limit=limit, legend=False)
    height, width = flow.shape[:2]
    return Panel(title=title, shape=(height, width), draw=lambda axes: draw(axes=axes))


def _arrow_panel(
    title: str, image: NDArray[np.generic], flow: NDArray[np.floating], limit: float
) -> Panel:
    draw = partial(draw_arrows, image, flow, limit=limit)
    height, width = flow.shape[:2]
    return Panel(title=title, shape=(height, width), draw=lambda axes: draw(axes=axes))


def _optional_map(name: str, values: ArrayLike | None) -> NDArray[np.floating] | None:
    return None if values is None else as_map(name, values)


def _require_frame_size(
    frame: NDArray[np.generic], arrays: Mapping[str, NDArray[np.generic] | None]
) -> None:
    for name, array in arrays.items():
        if array is not None:
            require_same_size(name, array, "frame", frame)


def _flow_limit(limit: float | None, flow: NDArray[np.floating]) -> float:
    return usual_length(flow) if limit is None else check_limit("flow_limit", limit)


def _depth_limit(limit: float | None, inverse_depth: NDArray[np.floating]) -> float:
    if limit is None:
        return inverse_depth_limit(inverse_depth)
    return check_limit("depth_limit", limit)


def _titles(names: Mapping[str, str] | None) -> dict[str, str]:
    """Return the titles of the panels, with the changes of the caller."""
    changes = dict(names or {})
    unknown = sorted(set(changes) - set(_TITLES))
    if unknown:
        raise InputError(f"names has {', '.join(unknown)}, expected any of {', '.join(_TITLES)}")
    return {**_TITLES, **changes}


def _default_columns(images: Sequence[NDArray[np.uint8]]) -> int:
    """Return the number of columns for the ratio of sides nearest to `_PANEL_FIGURE_RATIO`."""
    count = len(images)
    if count <= 3:
        return count
    width, height = np.mean([panel_size(*image.shape[:2]) for image in images], axis=0)
    side_ratios = {
        columns: columns * width / (math.ceil(count / columns) * height)
        for columns in range(1, count + 1)
    }
    return min(
        side_ratios, key=lambda columns: abs(math.log(side_ratios[columns] / _PANEL_FIGURE_RATIO))
    )
