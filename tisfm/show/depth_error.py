"""The error of a depth, beside the depth and the true one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.metrics import depth_error_map, depth_errors
from tisfm.show.arrays import as_map, is_depth, require_same_size
from tisfm.show.depth import depth_to_color, inverse_depth_limit
from tisfm.show.error import check_error_limits, error_to_color
from tisfm.show.legends import (
    BAR_SIZE,
    DEPTH_BAR_SIZE,
    draw_color_bar,
    draw_depth_bar,
    draw_panels,
)
from tisfm.show.mosaic import WIDE, beside_legends, beside_size
from tisfm.show.palette import color_ramp

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEPTH_ERROR_RANGE = (1 / 64, 1.0)
"""Default ends of the scale of relative errors of depth: six doublings, up to all of the depth."""


def depth_error_figure(
    depth: ArrayLike,
    truth: ArrayLike,
    *,
    title: str | None = None,
    limits: tuple[float, float] = DEPTH_ERROR_RANGE,
    unit: str = "relative",
) -> Figure:
    """Show a depth beside the true one on one scale, and its relative error.

    The depth is scaled by the median first, as by `tisfm.metrics.depth_errors`. Colours are
    linear in inverse depth, near is bright, and the brightest is the 95th percentile of the truth.
    Errors have the colours of `error_to_color`, on a logarithmic scale.

    Parameters
    ----------
    depth, truth : (H, W) array_like
        Recovered and true depth, each in a unit of its own; not finite or not positive where it
        is not known.
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
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import depth_error_figure, save_figure
    >>> scene = two_blocks(48, 64)
    >>> save_figure("depth.png", depth_error_figure(scene.depth**1.1, scene.depth), dpi=60)
    """
    recovered, true = as_map("depth", depth), as_map("truth", truth)
    require_same_size("truth", true, "depth", recovered)
    low, high = check_error_limits(limits)
    scale = depth_errors(recovered, true).scale
    error = error_to_color(depth_error_map(recovered, true), limits=(low, high))
    true_inverse = _inverse(true)
    top = inverse_depth_limit(true_inverse)
    panels = [
        (
            "Recovered depth (near is bright)",
            depth_to_color(_inverse(recovered) / scale, limit=top),
        ),
        ("True depth (grey: unknown)", depth_to_color(true_inverse, limit=top)),
        ("Relative error (grey: unknown)", error),
    ]
    height, width = true.shape
    rows = [panels] if width < WIDE * height else [[panel] for panel in panels]
    legends = [DEPTH_BAR_SIZE, BAR_SIZE]
    figure, _, layout = draw_panels(rows, heading=title, legend=beside_size(legends))
    of_depth, of_error = beside_legends(layout, legends)
    draw_depth_bar(figure, of_depth, color_ramp("depth"), top, label=f"depth Z\n({unit})")
    ramp = np.geomspace(high, low, 256)[:, None]  # the greatest error on top
    percent = (100 * low, 100 * high)
    draw_color_bar(figure, of_error, error_to_color(ramp, limits=(low, high)), percent, unit="%")
    return figure


def _inverse(depth: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the inverse depth, NaN where there is no depth."""
    known = is_depth(depth)
    inverse = np.full(depth.shape, np.nan)
    np.divide(1.0, depth, out=inverse, where=known)
    return inverse
