"""Flow errors as colours, and the figures of an evaluation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.show.arrays import as_flow, as_map, check_limit, require_same_size
from tisfm.show.flow import flow_to_color, usual_length
from tisfm.show.legends import (
    BAR_SIZE,
    WHEEL_SIZE,
    draw_color_bar,
    draw_panels,
    draw_wheel,
)
from tisfm.show.mosaic import WIDE
from tisfm.show.palette import colors_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ERROR_RANGE = (1 / 16, 16.0)
"""Default ends of the scale of errors, px: eight doublings, with 1 px in the middle."""


def error_to_color(
    error: ArrayLike, *, limits: tuple[float, float] = ERROR_RANGE
) -> NDArray[np.uint8]:
    """Show the length of flow errors as colours, from dark violet through green to yellow.

    The scale is logarithmic, so that one range serves a tenth of a pixel and ten alike and
    pictures of all datasets can be compared: each doubling of the error is the same step of the
    map, which is even to the eye (viridis).

    Parameters
    ----------
    error : (H, W) array_like
        Length of the error, px, such as from `tisfm.metrics.endpoint_error_map`. Where it is NaN,
        the truth is unknown: grey.
    limits : (float, float)
        Errors at the two ends of the map, px. Smaller and greater ones are shown as these.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Colours red, green, blue.

    Raises
    ------
    ValueError
        If `error` is not (H, W) or the limits are not finite, positive and in order.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import error_to_color
    >>> error_to_color(np.array([[0.1, 1.0, 10.0]])).shape
    (1, 3, 3)
    """
    values = as_map("error", error)
    low, high = check_error_limits(limits)
    known = ~np.isnan(values)
    share = np.full(values.shape, np.nan)
    clipped = np.clip(values[known].astype(np.float64), low, high)
    # Differences of logarithms: the ratio of far ends overflows.
    span = math.log2(high) - math.log2(low)
    share[known] = (np.log2(clipped) - math.log2(low)) / span
    return colors_of(share, "error")


def error_figure(
    error: ArrayLike, *, title: str | None = None, limits: tuple[float, float] = ERROR_RANGE
) -> Figure:
    """Show a map of flow errors with its scale.

    Parameters
    ----------
    error : (H, W) array_like
        Length of the error, px; NaN where the truth is unknown.
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
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.metrics import endpoint_error_map
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import error_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> error = endpoint_error_map(1.1 * scene.flow, scene.flow)
    >>> save_figure("error.png", error_figure(error), dpi=60)
    """
    values = as_map("error", error)
    low, high = check_error_limits(limits)
    picture = error_to_color(values, limits=limits)
    label = "End-point error (grey: truth unknown)"
    figure, _, layout = draw_panels([[(label, picture)]], heading=title, legend=BAR_SIZE)
    ramp = np.geomspace(high, low, 256)[:, None]  # the greatest error on top
    bar = error_to_color(ramp, limits=(low, high))
    draw_color_bar(figure, layout, bar, (low, high), unit="px")
    return figure


def flow_figure(
    flow: ArrayLike,
    truth: ArrayLike,
    *,
    title: str | None = None,
    limit: float | None = None,
) -> Figure:
    """Show a flow beside the true one, as colours of one range.

    Parameters
    ----------
    flow, truth : (H, W, 2) array_like
        Recovered and true flow, px/frame. Unknown, NaN or beyond 1e9, is black.
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
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import flow_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> save_figure("flow.png", flow_figure(1.1 * scene.flow, scene.flow), dpi=60)
    """
    recovered, true = as_flow("flow", flow), as_flow("truth", truth)
    require_same_size("truth", true, "flow", recovered)
    top = usual_length(true) if limit is None else check_limit("limit", limit)
    panels = [
        ("Recovered flow", flow_to_color(recovered, limit=top, beyond="same")),
        ("True flow (black: unknown)", flow_to_color(true, limit=top, beyond="same")),
    ]
    height, width = recovered.shape[:2]
    rows = [panels] if width < WIDE * height else [[panel] for panel in panels]
    figure, _, layout = draw_panels(rows, heading=title, legend=WHEEL_SIZE)
    draw_wheel(figure, layout, top)
    return figure


def check_error_limits(limits: tuple[float, float]) -> tuple[float, float]:
    """Return the ends of a logarithmic scale, or raise an error unless they make one."""
    low, high = limits
    if not (math.isfinite(low) and math.isfinite(high) and 0 < low < high):
        raise InputError(f"limits is {limits!r}, expected two finite numbers with 0 < low < high")
    return float(low), float(high)
