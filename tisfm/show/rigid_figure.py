"""The figure of rigid motions: depth and how uncertain it is, labels, motion and confidence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tisfm.checks import refuse_masked, unmasked_mask
from tisfm.show.arrays import as_flow, as_image, as_map, as_uint8, check_limit, require_same_size
from tisfm.show.confidence import confidence_to_color
from tisfm.show.depth import depth_to_color, inverse_depth_limit
from tisfm.show.error import error_to_color
from tisfm.show.figures import tint
from tisfm.show.flow import flow_to_color, usual_length
from tisfm.show.labels import label_overlay
from tisfm.show.legends import (
    BAR_SIZE,
    DEPTH_BAR_SIZE,
    LEGEND_SIZE,
    backdrop,
    draw_arrows,
    draw_color_bar,
    draw_depth_bar,
    draw_legend,
    draw_panels,
    draw_swatches,
    swatches_size,
)
from tisfm.show.mosaic import WIDE, beside_legends, beside_size, stack_legends, stacked_size
from tisfm.show.palette import color_ramp, colors_of_categories
from tisfm.show.uncertainty import UNCERTAINTY_RANGE, uncertainty_to_color

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

    The first row has the frame, the labels where there are several, the depth in the colours of
    `depth_to_color`, the true one where it is known, and the relative standard deviation where a
    pixel is visible in the next frame. The second row has the flow as arrows and as colours, the
    true one where it is known, and the confidence. Of wide pictures there are two in a row, in the
    same order.

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) array_like
        The first frame: uint8, uint16 or float.
    inverse_depth, inverse_depth_std : (H, W) array_like
        Inverse depth in any unit and its standard deviation. There is no depth where the former is
        not positive.
    flow : (H, W, 2) array_like
        Image motion, px/frame.
    confidence : (H, W) array_like
        In [0, 1].
    labels : (H, W) array_like of int, optional
        Which motion a pixel has, from 0, the background.
    occlusion : (H, W) array_like, optional
        Nonzero where a pixel is not visible in the next frame: red in the first panel.
    truth_flow : (H, W, 2) array_like, optional
        True flow, px/frame. Unknown are NaN and values beyond 1e9.
    truth_inverse_depth : (H, W) array_like, optional
        True inverse depth. Its unit is its own, and so is its range.
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
    ImportError
        If Matplotlib is not installed.

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
    depth, deviation = (
        as_map("inverse_depth", inverse_depth),
        as_map("inverse_depth_std", inverse_depth_std),
    )
    motion, trust = as_flow("flow", flow), as_map("confidence", confidence)
    true_motion = None if truth_flow is None else as_flow("truth_flow", truth_flow)
    true_depth = (
        None if truth_inverse_depth is None else as_map("truth_inverse_depth", truth_inverse_depth)
    )
    hidden = None if occlusion is None else unmasked_mask(occlusion, "occlusion")
    refuse_masked(labels, "labels", "fill them first, for instance by labels.filled(0)")
    arrays = {
        "inverse_depth": depth,
        "inverse_depth_std": deviation,
        "flow": motion,
        "confidence": trust,
        "truth_flow": true_motion,
        "truth_inverse_depth": true_depth,
        "occlusion": hidden,
    }
    for name, array in arrays.items():
        if array is not None:
            require_same_size(name, array, "frame", picture)
    known_motion = motion if true_motion is None else true_motion
    limit = (
        usual_length(known_motion) if flow_limit is None else check_limit("flow_limit", flow_limit)
    )
    nearest = (
        inverse_depth_limit(depth)
        if depth_limit is None
        else check_limit("depth_limit", depth_limit)
    )
    scales = {f"depth Z\n({unit})": nearest}
    found = [0] if labels is None else [int(label) for label in np.unique(labels)]

    (shown,) = as_uint8(picture)
    first = [
        ("Frame", shown)
        if hidden is None
        else ("Frame (red: not visible in the next)", tint(shown, hidden))
    ]
    if labels is not None and found[-1] > 0:
        first.append(("Motions", label_overlay(shown, labels)))
    any_depth = bool((depth > 0).any())
    first.append(
        (
            "Depth (near is bright)" if any_depth else "Depth: none to be seen",
            depth_to_color(depth, limit=nearest),
        )
    )
    if true_depth is not None:
        first.append(("True depth (near is bright)", depth_to_color(true_depth)))
        scales["true Z\n(its unit)"] = inverse_depth_limit(true_depth)
    if hidden is not None:  # it is that of what is visible
        deviation = np.where(hidden, np.inf, deviation)
    uncertainty = uncertainty_to_color(depth, deviation)
    first.append(("Uncertainty of the depth (grey: unknown)", uncertainty))
    second = [
        ("Flow, arrows", backdrop(shown)),
        ("Flow, colours", flow_to_color(motion, limit=limit, beyond="same")),
    ]
    if true_motion is not None:
        second.append(
            ("True flow, colours", flow_to_color(true_motion, limit=limit, beyond="same"))
        )
    second.append(("Confidence (yellow: 1)", confidence_to_color(trust)))

    bars = [DEPTH_BAR_SIZE] * len(scales) + [BAR_SIZE]
    legends = [beside_size(bars), LEGEND_SIZE]
    if found[-1] > 0:
        legends.insert(0, swatches_size(len(found)))
    rows = [first, second]
    if picture.shape[1] >= WIDE * picture.shape[0]:
        panels = first + second
        rows = [panels[k : k + 2] for k in range(0, len(panels), 2)]
    figure, axes, layout = draw_panels(rows, heading=title, legend=stacked_size(legends))
    draw_arrows(axes[len(first)], motion, limit)
    *swatches, beside, wheel = stack_legends(layout, legends)
    *of_depth, bar = beside_legends(beside, bars)
    for room, (label, top) in zip(of_depth, scales.items(), strict=True):
        draw_depth_bar(figure, room, color_ramp("depth"), top, label=label)
    for room in swatches:
        names = ["0, background" if label == 0 else str(label) for label in found]
        draw_swatches(figure, room, colors_of_categories(np.array(found)), names)
    low, high = UNCERTAINTY_RANGE
    ramp = error_to_color(np.geomspace(high, low, 256)[:, None], limits=UNCERTAINTY_RANGE)
    draw_color_bar(figure, bar, ramp, (100 * low, 100 * high), unit="%")
    draw_legend(figure, wheel, (picture.shape[0], picture.shape[1]), limit)
    return figure
