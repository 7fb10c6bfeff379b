"""Legends of the pictures of a report."""

from collections.abc import Sequence
from dataclasses import dataclass

from tisfm.report.embedded_images import png_url
from tisfm.show import UNCERTAINTY_RANGE, color_ramp, color_wheel
from tisfm.show.palette import Quantity, as_hex

_BAR_COLORS = 9  # colours that the browser interpolates, set by hand
_WHEEL_PIXELS = 88  # width of the colour wheel, px: twice its width on the page


@dataclass(frozen=True, kw_only=True)
class Legend:
    """A bar of colours with texts at both ends, or a colour wheel with a text."""

    picture: str  # title of the pictures that have these colours
    title: str
    text: str  # the text at the end of the bar, or beside the wheel
    low: str = ""  # the text at the beginning of the bar
    colors: Sequence[str] = ()  # colours of the bar, ``#rrggbb``
    wheel: str = ""  # data address of the wheel; empty for a bar


def depth_legend(picture: str, unit: str) -> Legend:
    """Return the colours of depth, one range for all frames."""
    text = f"near; grey: none; one range for all, {unit}"
    return Legend(picture=picture, title="Depth", low="far", text=text, colors=_colors("depth"))


def confidence_legend(picture: str) -> Legend:
    """Return the colours of confidence."""
    return Legend(
        picture=picture,
        title=picture,
        low="0",
        text="1: the data alone decide",
        colors=_colors("confidence"),
    )


def deviation_legend(picture: str) -> Legend:
    """Return the colours of the relative deviation of depth."""
    low, high = UNCERTAINTY_RANGE
    return Legend(
        picture=picture,
        title="Deviation of depth",
        low=f"{100 * low:g} %",
        text=f"{100 * high:g} % and more; grey: not known",
        colors=_colors("error"),
    )


def flow_legend(picture: str, title: str, limit: float) -> Legend:
    """Return the colour wheel of image motion, with a motion of `limit` px/frame at its rim."""
    text = f"direction as hue; rim: {limit:.2g} px a frame and more"
    return Legend(
        picture=picture, title=title, text=text, wheel=png_url(color_wheel(_WHEEL_PIXELS))
    )


def _colors(quantity: Quantity) -> list[str]:
    return [as_hex(color) for color in color_ramp(quantity)[:: 255 // (_BAR_COLORS - 1)]]
