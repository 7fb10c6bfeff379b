"""Image motion as colours and as arrows, into axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.show.arrays import as_flow, as_image, as_uint8, check_limit, require_same_size
from tisfm.show.axes import Sizes, legend_axes, picture_axes, show_picture
from tisfm.show.flow import color_wheel, flow_to_color, quiver_points, usual_length
from tisfm.show.mosaic import panel_size
from tisfm.show.palette import TEXT_COLOR

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Numbers set by hand.
_WHEEL_PIXELS = 400  # width of the colour wheel beside a picture, px
_FRAME_BRIGHTNESS = 0.6  # factor of the grey levels of a frame under arrows
_ARROW_SPACING = 0.17  # inches between arrows, in a panel of the size that `panel_size` returns
_LIMIT_ARROW_LENGTH = 2.0  # arrow spacings: length of the arrow of a motion at the limit
_MAX_ARROW_MOTION = 3.0  # limits: longer motion has the arrow of this motion
ARROW_STYLE: dict[str, Any] = {
    "angles": "xy",
    "scale_units": "xy",
    "scale": 1.0,
    "units": "inches",
    "width": 0.018,
    "headwidth": 3.6,
    "headlength": 4.2,
    "headaxislength": 3.6,
    "minlength": 0.8,
    "facecolor": "#ffdd33",
    "edgecolor": "black",
    "linewidth": 0.35,
}


def draw_flow(
    flow: ArrayLike,
    *,
    axes: Axes | None = None,
    limit: float | None = None,
    legend: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw image motion in the colours of `flow_to_color`, with the colour wheel.

    The wheel is the wheel of the Middlebury benchmark, so that pictures can be compared with
    pictures of other projects. Its hues are not perceptually uniform, and some look alike with a
    colour vision deficiency. Where this matters, draw errors or lengths (`draw_flow_error`,
    `flow_radius`).

    Parameters
    ----------
    flow : (H, W, 2) array_like
        Image motion, px/frame; unknown pixels are black.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    limit : float, optional
        Motion at the rim of the wheel, px/frame, by default the 98th percentile of the length
        of the motion. Longer motion has the colours of the rim.
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
        As `flow_to_color`.

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
    limit_motion = usual_length(values) if limit is None else check_limit("limit", limit)
    target = picture_axes(*values.shape[:2]) if axes is None else axes
    sizes = show_picture(target, flow_to_color(values, limit=limit_motion, beyond="same"), title)
    if legend:
        _draw_wheel(target, limit_motion, sizes)
    return target


def draw_arrows(
    image: ArrayLike,
    flow: ArrayLike,
    *,
    axes: Axes | None = None,
    limit: float | None = None,
    title: str | None = None,
) -> Axes:
    """Draw image motion as yellow arrows over a dimmed grey picture.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like
        Picture: uint8, uint16 or float.
    flow : (H, W, 2) array_like
        Image motion, px/frame. Unknown motion has no arrow.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    limit : float, optional
        Motion, px/frame, whose arrow is two grid steps long; by default the 98th percentile of the
        length of the motion. No arrow is longer than six grid steps. At 0 there are no arrows.
    title : str, optional
        Text above the picture.

    Returns
    -------
    matplotlib.axes.Axes
        The axes of the picture.

    Raises
    ------
    ValueError
        If a shape is wrong, sizes differ, or the limit is negative or not finite.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_arrows, save_figure
    >>> scene = two_blocks(48, 64)
    >>> save_figure("arrows.png", draw_arrows(scene.frame0, scene.flow).figure, dpi=60)
    """
    picture, values = as_image("image", image), as_flow("flow", flow)
    require_same_size("flow", values, "image", picture)
    limit_motion = usual_length(values) if limit is None else check_limit("limit", limit)
    target = picture_axes(*values.shape[:2]) if axes is None else axes
    show_picture(target, _dim_frame(as_uint8(picture)[0]), title)
    if limit_motion == 0:
        return target
    step, magnification = arrow_scale(values.shape[:2], limit_motion)
    arrows = quiver_points(values, step)
    length = np.hypot(arrows.u, arrows.v)
    # Without this bound, one wrong, very long vector would cross the whole picture.
    factor = magnification * np.minimum(
        1, _MAX_ARROW_MOTION * limit_motion / np.maximum(length, limit_motion)
    )
    target.quiver(arrows.x, arrows.y, arrows.u * factor, arrows.v * factor, **ARROW_STYLE)
    return target


def arrow_scale(
    shape: tuple[int, int],  # height and width of the picture, px
    limit: float,  # motion whose arrow is two spacings long, px/frame; above 0
) -> tuple[int, float]:
    """Choose the grid and the length of the arrows over a picture.

    Returns the distance between arrows, px, and the drawn length of an arrow, px, per length of
    motion, px/frame.
    """
    pixels_per_inch = shape[1] / panel_size(*shape)[0]
    spacing = _ARROW_SPACING * pixels_per_inch
    return max(1, round(spacing)), _LIMIT_ARROW_LENGTH * spacing / limit


def _dim_frame(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture as dark grey levels, on which bright arrows are visible."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    return np.rint(grey * np.float32(_FRAME_BRIGHTNESS)).astype(np.uint8)


def _draw_wheel(axes: Axes, limit: float, sizes: Sizes) -> None:
    """Draw the colour wheel beside a picture, and the motion at its rim."""
    box = axes.get_window_extent()
    height, width = (side / axes.figure.dpi for side in (box.height, box.width))
    rim = f"{limit:.0f}" if limit >= 100 else f"{limit:.2g}"
    texts = [f"rim: ≥ {rim}", "px/frame"]
    diameter = min(0.2 * width, max(0.6 * height, 2.0 * sizes.text_inches))
    width_inches = max(diameter, 0.62 * max(map(len, texts)) * sizes.text_inches)
    space = legend_axes(axes, width_inches, 0.5 * sizes.text_inches)
    wheel = space.inset_axes((0.0, 0.3, 1.0, 0.7))
    wheel.imshow(color_wheel(_WHEEL_PIXELS), aspect="equal", interpolation="antialiased")
    wheel.set_anchor("S")
    wheel.set_axis_off()
    space.text(
        0.5,
        0.28,
        "\n".join(texts),
        transform=space.transAxes,
        ha="center",
        va="top",
        fontsize=sizes.text,
        color=TEXT_COLOR,
    )
