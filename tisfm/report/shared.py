"""What both reports say alike: legends."""

from tisfm.report.page import color_bar
from tisfm.report.pictures import png_url, ramp
from tisfm.show import UNCERTAINTY_RANGE, color_wheel, error_to_color

_STOPS = 9


def depth_legend(unit: str) -> str:
    """Return the colours of depth, one range for all frames, as HTML."""
    return color_bar(_stops("magma"), "far, or none", f"near; one range for all, {unit}")


def share_legend() -> str:
    """Return the colours of confidence, as HTML."""
    return color_bar(_stops("cividis"), "0", "1: the data alone decide")


def deviation_legend() -> str:
    """Return the colours of the relative deviation of depth, as HTML."""
    import numpy as np

    low, high = UNCERTAINTY_RANGE
    values = np.geomspace(low, high, _STOPS)[None]
    colors = error_to_color(values, limits=UNCERTAINTY_RANGE)[0].tolist()
    return color_bar(colors, f"{100 * low:g} %", f"{100 * high:g} % and more; grey: not known")


def flow_legend(limit: float) -> str:
    """Return the wheel of colours of image motion, px at its rim, as HTML."""
    wheel = png_url(color_wheel(88))
    return (
        f'<img src="{wheel}" alt="wheel of colours"><span>direction as hue; rim: '
        f"{limit:.2g} px a frame</span>"
    )


def _stops(name: str) -> list[list[int]]:
    colors = ramp(name)
    stops: list[list[int]] = colors[:: 255 // (_STOPS - 1)].tolist()
    return stops
