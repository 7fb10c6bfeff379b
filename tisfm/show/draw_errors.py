"""Errors against the truth, and calibration of standard deviations, into axes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.metrics import depth_error_map, endpoint_error_map
from tisfm.metrics.depth_std import error_in_deviations
from tisfm.metrics.valid_pixels import is_known
from tisfm.show.arrays import as_flow, as_map, require_same_size, valid_depth_mask
from tisfm.show.axes import label_axes, plot_axes, style_plot
from tisfm.show.color_maps import DEPTH_ERROR_RANGE, ERROR_RANGE, check_error_limits, error_to_color
from tisfm.show.draw_maps import Bar, draw_with_bar
from tisfm.show.palette import GRID_COLOR, RESULT_COLOR, TEXT_COLOR, color_ramp
from tisfm.show.ticks import doubling_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_DEVIATIONS = 3.0  # standard deviations, the end of the axis of a calibration plot
_CURVE_POINTS = 121  # points of a calibration curve; set by hand


def draw_flow_error(
    flow: ArrayLike,
    truth: ArrayLike,
    *,
    axes: Axes | None = None,
    limits: tuple[float, float] = ERROR_RANGE,
    legend: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw the end-point error of a flow in the colours of `error_to_color`.

    Parameters
    ----------
    flow, truth : (H, W, 2) array_like
        Recovered and true flow, px/frame. Pixels without a known truth are grey.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    limits : (float, float)
        Errors at the two ends of the logarithmic scale, px.
    legend : bool
        Whether to draw the legend.
    title : str, optional
        Text above the picture, by default the mean error.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    ValueError
        If a shape is wrong, sizes differ, or the limits are not finite, positive and in order.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_flow_error, save_figure
    >>> scene = two_blocks(48, 64)
    >>> save_figure("error.png", draw_flow_error(1.1 * scene.flow, scene.flow).figure, dpi=60)
    """
    recovered_values, true_values = as_flow("flow", flow), as_flow("truth", truth)
    require_same_size("truth", true_values, "flow", recovered_values)
    check_error_limits(limits)
    error = np.full(true_values.shape[:2], np.nan)
    if is_known(true_values).all(axis=2).any():
        error = endpoint_error_map(recovered_values, true_values)
    title = _mean_title(error, "px") if title is None else title
    label = "end-point error (px)", "error (px)"
    return draw_error_map(
        error, limits, unit="px", label=label, legend=legend, axes=axes, title=title
    )


def draw_depth_error(
    depth: ArrayLike,
    truth: ArrayLike,
    *,
    axes: Axes | None = None,
    limits: tuple[float, float] = DEPTH_ERROR_RANGE,
    legend: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw the relative error of a depth after scaling by the median.

    Parameters
    ----------
    depth, truth : (H, W) array_like
        Recovered and true depth, each in its own unit. A value that is not finite and positive is
        unknown: grey.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    limits : (float, float)
        Relative errors at the two ends of the logarithmic scale.
    legend : bool
        Whether to draw the legend.
    title : str, optional
        Text above the picture, by default the mean error.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    ValueError
        If a shape is wrong, sizes differ, or the limits are not finite, positive and in order.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_depth_error, save_figure
    >>> scene = two_blocks(48, 64)
    >>> save_figure("error.png", draw_depth_error(scene.depth**1.1, scene.depth).figure, dpi=60)
    """
    recovered_values, true_values = as_map("depth", depth), as_map("truth", truth)
    require_same_size("truth", true_values, "depth", recovered_values)
    low, high = check_error_limits(limits)
    error = np.full(true_values.shape, np.nan)
    if (valid_depth_mask(true_values) & valid_depth_mask(recovered_values)).any():
        error = 100 * depth_error_map(recovered_values, true_values)
    title = _mean_title(error, "%") if title is None else title
    percent_limits = (100 * low, 100 * high)
    label = "error of depth (%)", "error (%)"
    return draw_error_map(
        error, percent_limits, unit="%", label=label, legend=legend, axes=axes, title=title
    )


def draw_calibration(
    inverse_depth: ArrayLike,
    inverse_depth_std: ArrayLike,
    truth: ArrayLike,
    *,
    axes: Axes | None = None,
    title: str | None = None,
) -> Axes:
    """Draw the share of depth errors within a number of standard deviations.

    If the deviations are right, the curve is the curve of normal errors: 68 % are within one
    standard deviation, 95 % within two. A lower curve means that the deviations are too small.

    Parameters
    ----------
    inverse_depth, inverse_depth_std : (H, W) array_like
        Inverse depth and its standard deviation. Both are first scaled by the median, as in
        `tisfm.metrics.std_coverage`.
    truth : (H, W) array_like
        True depth. A value that is not finite and positive is unknown.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    title : str, optional
        Text above the plot.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the plot.

    Raises
    ------
    ValueError
        As `tisfm.metrics.std_coverage`.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_calibration, save_figure
    >>> scene = two_blocks(48, 64)
    >>> deviation = 0.05 * scene.inverse_depth
    >>> noise = np.random.default_rng(0).normal(size=deviation.shape)
    >>> axes = draw_calibration(scene.inverse_depth + noise * deviation, deviation, scene.depth)
    >>> save_figure("calibration.png", axes.figure, dpi=60)
    """
    estimate, deviation = (
        as_map("inverse_depth", inverse_depth),
        as_map("inverse_depth_std", inverse_depth_std),
    )
    true_values = as_map("truth", truth)
    ratios = error_in_deviations(estimate, deviation, true_values)
    thresholds = np.linspace(0, _MAX_DEVIATIONS, _CURVE_POINTS)
    measured_percent = (
        100 * np.searchsorted(np.sort(ratios), thresholds, side="right") / len(ratios)
    )
    expected_percent = [100 * math.erf(threshold / math.sqrt(2)) for threshold in thresholds]
    target = plot_axes(4.4, 3.4) if axes is None else axes
    sizes = style_plot(target, title)
    target.plot(
        thresholds,
        expected_percent,
        color=TEXT_COLOR,
        linewidth=sizes.line,
        linestyle="--",
        label="normal errors",
    )
    target.plot(
        thresholds,
        measured_percent,
        color=RESULT_COLOR,
        linewidth=1.6 * sizes.line,
        label=f"measured: {100 * (ratios <= 1).mean():.0f} % within one",
    )
    target.axvline(1.0, color=GRID_COLOR, linewidth=0.5 * sizes.line, linestyle=":")
    target.set(xlim=(0, _MAX_DEVIATIONS), ylim=(0, 102), xticks=(0, 1, 2, 3))
    target.set_yticks((0, 25, 50, 75, 100))
    label_axes(target, sizes, "error (standard deviations)", "pixels within (%)")
    target.legend(loc="lower right", fontsize=sizes.text, labelcolor=TEXT_COLOR, framealpha=0.8)
    return target


def _mean_title(error: NDArray[np.floating], unit: str) -> str:
    """Return a title with the mean of the known errors."""
    known_errors = error[np.isfinite(error)]
    return (
        f"mean {known_errors.mean():.3g} {unit}"
        if known_errors.size
        else "no truth to compare with"
    )


def draw_error_map(
    error: NDArray[np.floating],
    limits: tuple[float, float],
    *,
    unit: str,
    label: tuple[str, str],  # long and short label of the bar
    legend: bool = True,
    axes: Axes | None = None,
    title: str | None = None,
) -> Axes:
    """Draw a map of errors, with the bar of its colours unless `legend` is false."""
    bar = Bar(ramp=color_ramp("error"), ticks=doubling_ticks(limits, unit), label=label)
    colors = error_to_color(error, limits=limits)
    return draw_with_bar(colors, bar if legend else None, axes, title)
