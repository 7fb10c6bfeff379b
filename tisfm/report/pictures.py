"""Pictures inside a page, limited in size, and the legends of their colours."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.show import UNCERTAINTY_RANGE, color_ramp, color_wheel
from tisfm.show.arrays import as_rgb, as_uint8
from tisfm.show.palette import Quantity, as_hex

# Set by hand.
MAX_SLIDES = 48
MAX_SIDE = 560  # px
MAX_TOTAL_BYTES = (
    13_000_000  # bytes of all pictures; base64 adds a third, and the page stays below 20 MB
)
_QUALITIES = (86, 75, 60, 40, 20)  # of JPEG, in the order of trial


class Pictures:
    """Makes pictures whose bytes together stay within a budget."""

    def __init__(
        self,
        count: int,  # number of pictures
        *,
        budget: int = MAX_TOTAL_BYTES,  # bytes of all pictures
    ) -> None:
        self._max_bytes = budget // max(count, 1)

    def url(self, picture: NDArray[np.generic]) -> str:
        """Return a picture, (H, W) or (H, W, 3), as a data address with a JPEG."""
        (levels,) = as_uint8(picture)
        image = Image.fromarray(np.ascontiguousarray(as_rgb(levels)))
        side = MAX_SIDE
        while True:
            resized = image.copy()
            resized.thumbnail((side, side), Image.Resampling.BOX)
            for quality in _QUALITIES:
                data = io.BytesIO()
                resized.save(data, "JPEG", quality=quality, subsampling=0)
                if data.tell() <= self._max_bytes or side <= 8:
                    return _address("jpeg", data.getvalue())
            side //= 2


def png_url(picture: NDArray[np.uint8]) -> str:
    """Return a small drawing, such as a legend, as a data address with a PNG."""
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "PNG", optimize=True)
    return _address("png", data.getvalue())


def choose_slides(
    count: int,  # number of frames
    # required frames, such as the first of each status, the most important first; at most half of
    # `max_count`
    required: list[int],
    max_count: int = MAX_SLIDES,  # limit of the frames to show
) -> list[int]:
    """Return the numbers of the frames to show: required frames, and others evenly spread."""
    if count <= max_count:
        return list(range(count))
    chosen = list(dict.fromkeys(required))[: max_count // 2]
    remaining = max_count - len(chosen)
    evenly_spaced = {round(k * (count - 1) / (remaining - 1)) for k in range(remaining)}
    return sorted({*chosen, *evenly_spaced})


def _address(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


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
