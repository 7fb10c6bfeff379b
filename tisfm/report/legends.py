"""What both reports say alike: legends."""

from markupsafe import Markup

from tisfm.report.embedded_images import png_url
from tisfm.report.page import color_bar
from tisfm.show import UNCERTAINTY_RANGE, color_ramp, color_wheel
from tisfm.show.palette import Quantity

_STOPS = 9


def depth_legend(unit: str) -> Markup:
    """Return the colours of depth, one range for all frames, as HTML."""
    return color_bar(_stops("depth"), "far", f"near; grey: none; one range for all, {unit}")


def share_legend() -> Markup:
    """Return the colours of confidence, as HTML."""
    return color_bar(_stops("confidence"), "0", "1: the data alone decide")


def deviation_legend() -> Markup:
    """Return the colours of the relative deviation of depth, as HTML."""
    low, high = UNCERTAINTY_RANGE
    return color_bar(
        _stops("error"), f"{100 * low:g} %", f"{100 * high:g} % and more; grey: not known"
    )


def flow_legend(limit: float) -> Markup:
    """Return the wheel of colours of image motion, px at its rim, as HTML."""
    wheel = png_url(color_wheel(88))
    return Markup(
        '<img src="{}" alt="wheel of colours"><span>direction as hue; rim: {:.2g} px a frame and '
        "more</span>"
    ).format(wheel, limit)


def _stops(quantity: Quantity) -> list[list[int]]:
    colors = color_ramp(quantity)
    stops: list[list[int]] = colors[:: 255 // (_STOPS - 1)].tolist()
    return stops
