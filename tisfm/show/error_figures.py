"""Figures of the errors of a flow, and of a depth beside the true depth."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.metrics import depth_error_map, depth_errors
from tisfm.show.arrays import as_flow, as_map, check_limit, require_same_size, valid_depth_mask
from tisfm.show.color_maps import (
    DEPTH_ERROR_RANGE,
    ERROR_RANGE,
    check_error_limits,
    inverse_depth_limit,
)
from tisfm.show.draw_errors import draw_error_map
from tisfm.show.draw_flow import draw_flow
from tisfm.show.draw_maps import draw_depth
from tisfm.show.flow import usual_length
from tisfm.show.legends import depth_legend, error_legend, wheel_legend
from tisfm.show.mosaic import MIN_WIDE_RATIO, Panel, join_legends, mosaic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def error_figure(
    error: ArrayLike, *, title: str | None = None, limits: tuple[float, float] = ERROR_RANGE
) -> Figure:
    """Show a map of flow errors with its scale.

    Parameters
    ----------
    error : (H, W) array_like
        Length of the error, px; NaN means that the truth is unknown.
    title : str, optional
        Heading of the figure.
    limits : (float, float)
        As in `error_to_color`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, for `save_figure`.

    Raises
    ------
    ValueError
        As `error_to_color`.

    Examples
    --------
    >>> from tisfm.metrics import endpoint_error_map
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import error_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> error = endpoint_error_map(1.1 * scene.flow, scene.flow)
    >>> save_figure("error.png", error_figure(error), dpi=60)
    """
    values, (low, high) = as_map("error", error), check_error_limits(limits)
    panel = _error_panel("End-point error (grey: truth unknown)", values, (low, high), "px")
    return mosaic([[panel]], heading=title, legend=error_legend((low, high), "px"))


def flow_figure(
    flow: ArrayLike, truth: ArrayLike, *, title: str | None = None, limit: float | None = None
) -> Figure:
    """Show a flow beside the true flow, as colours of one range.

    Parameters
    ----------
    flow, truth : (H, W, 2) array_like
        Recovered and true flow, px/frame. Unknown flow, NaN or beyond 1e9, is black.
    title : str, optional
        Heading of the figure.
    limit : float, optional
        Motion at the rim of the colour wheel, px/frame, by default the 98th percentile of the
        length of the true flow.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, for `save_figure`.

    Raises
    ------
    ValueError
        If a shape is wrong, sizes differ, or the limit is negative or not finite.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import flow_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> save_figure("flow.png", flow_figure(1.1 * scene.flow, scene.flow), dpi=60)
    """
    recovered_values, true_values = as_flow("flow", flow), as_flow("truth", truth)
    require_same_size("truth", true_values, "flow", recovered_values)
    limit_motion = usual_length(true_values) if limit is None else check_limit("limit", limit)
    panels = [
        Panel(
            title=name,
            shape=(values.shape[0], values.shape[1]),
            draw=partial(_draw_flow, flow=values, limit=limit_motion),
        )
        for name, values in (
            ("Recovered flow", recovered_values),
            ("True flow (black: unknown)", true_values),
        )
    ]
    return mosaic(_arrange_rows(panels), heading=title, legend=wheel_legend(limit_motion))


def depth_error_figure(
    depth: ArrayLike,
    truth: ArrayLike,
    *,
    title: str | None = None,
    limits: tuple[float, float] = DEPTH_ERROR_RANGE,
    unit: str = "relative",
) -> Figure:
    """Show a depth beside the true depth on one scale, and the relative error.

    The depth is scaled by the median first, as by `tisfm.metrics.depth_errors`. Colours are
    linear in inverse depth: near is bright, and the 95th percentile of the truth is brightest.
    Errors have the colours of `error_to_color`, on a logarithmic scale.

    Parameters
    ----------
    depth, truth : (H, W) array_like
        Recovered and true depth, each in its own unit. A value that is not finite and positive is
        unknown.
    title : str, optional
        Heading of the figure.
    limits : (float, float)
        Relative errors at the two ends of the scale.
    unit : str
        Unit of the true depth, for the legend.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, for `save_figure`.

    Raises
    ------
    ValueError
        If a shape is wrong, sizes differ, no pixel has both depths, or the limits are not finite,
        positive and in order.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import depth_error_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> save_figure("depth.png", depth_error_figure(scene.depth**1.1, scene.depth), dpi=60)
    """
    recovered_values, true_values = as_map("depth", depth), as_map("truth", truth)
    require_same_size("truth", true_values, "depth", recovered_values)
    low, high = check_error_limits(limits)
    scale = depth_errors(recovered_values, true_values).scale
    true_inverse_depth = _inverse_depth(true_values)
    max_inverse_depth = inverse_depth_limit(true_inverse_depth)
    percent_limits = (100 * low, 100 * high)
    panels = [
        Panel(
            title=name,
            shape=(true_values.shape[0], true_values.shape[1]),
            draw=partial(_draw_depth, inverse_depth=inverse_depth, limit=max_inverse_depth),
        )
        for name, inverse_depth in (
            ("Recovered depth (near is bright)", _inverse_depth(recovered_values) / scale),
            ("True depth (grey: unknown)", true_inverse_depth),
        )
    ]
    error = 100 * depth_error_map(recovered_values, true_values)
    panels.append(_error_panel("Relative error (grey: unknown)", error, percent_limits, "%"))
    legend = join_legends(
        [depth_legend(max_inverse_depth, f"depth Z\n({unit})"), error_legend(percent_limits, "%")]
    )
    return mosaic(_arrange_rows(panels), heading=title, legend=legend)


def _error_panel(
    title: str, error: NDArray[np.floating], limits: tuple[float, float], unit: str
) -> Panel:
    def draw(axes: Axes) -> None:
        draw_error_map(error, limits, unit=unit, label=("", ""), legend=False, axes=axes)

    return Panel(title=title, shape=(error.shape[0], error.shape[1]), draw=draw)


def _draw_flow(axes: Axes, *, flow: NDArray[np.floating], limit: float) -> None:
    draw_flow(flow, axes=axes, limit=limit, legend=False)


def _draw_depth(axes: Axes, *, inverse_depth: NDArray[np.floating], limit: float) -> None:
    draw_depth(inverse_depth, axes=axes, limit=limit, legend=False)


def _arrange_rows(panels: list[Panel]) -> list[list[Panel]]:
    """Return rows of panels: wide panels below one another, others side by side."""
    height, width = panels[0].shape
    return [panels] if width < MIN_WIDE_RATIO * height else [[panel] for panel in panels]


def _inverse_depth(depth: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the inverse depth, NaN where there is no depth."""
    is_valid = valid_depth_mask(depth)
    inverse = np.full(depth.shape, np.nan)
    np.divide(1.0, depth, out=inverse, where=is_valid)
    return inverse
