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

# These numbers were set by hand.
MAX_SLIDES = 48
MAX_SIDE = 560  # px
# All pictures; base64 adds a third, so that the page stays below 20 MB.
MAX_TOTAL_BYTES = 13_000_000
_QUALITIES = (86, 75, 60, 40, 20)  # qualities of JPEG, in the order of trial


class Pictures:
    """A maker of pictures with a limited number of bytes in total."""

    def __init__(
        self,
        count: int,  # number of pictures
        *,
        max_total_bytes: int = MAX_TOTAL_BYTES,  # bytes of all pictures
    ) -> None:
        self._max_bytes = max_total_bytes // max(count, 1)

    def url(self, picture: NDArray[np.generic]) -> str:
        """Return a picture, (H, W) or (H, W, 3), as a data address with a JPEG."""
        (levels,) = as_uint8(picture)
        image = Image.fromarray(np.ascontiguousarray(as_rgb(levels)))
        side = MAX_SIDE
        while True:
            small_image = image.copy()
            small_image.thumbnail((side, side), Image.Resampling.BOX)
            for quality in _QUALITIES:
                data = io.BytesIO()
                small_image.save(data, "JPEG", quality=quality, subsampling=0)
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
    # required frames, such as the first frame of each status, in order of importance; at most half
    # of `max_count` are used
    required: list[int],
    max_count: int = MAX_SLIDES,  # limit of the number of frames
) -> list[int]:
    """Return the numbers of the frames to show: required frames, and evenly spaced frames."""
    if count <= max_count:
        return list(range(count))
    required_numbers = list(dict.fromkeys(required))[: max_count // 2]
    remaining = max_count - len(required_numbers)
    even_numbers = {round(k * (count - 1) / (remaining - 1)) for k in range(remaining)}
    return sorted({*required_numbers, *even_numbers})


def _address(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


_BAR_COLORS = 9  # colours of a bar; the browser interpolates them; set by hand
_WHEEL_PIXELS = 88  # width of the colour wheel, px: twice its width on the page


@dataclass(frozen=True, kw_only=True)
class Legend:
    """A bar of colours with texts at both ends, or a colour wheel with a text."""

    picture_title: str  # title of the pictures with these colours
    title: str
    text: str  # the text at the end of the bar, or beside the wheel
    low_text: str = ""  # the text at the beginning of the bar
    colors: Sequence[str] = ()  # colours of the bar, ``#rrggbb``
    wheel: str = ""  # data address of the wheel; empty for a bar


def depth_legend(picture_title: str, unit: str) -> Legend:
    """Return the legend of depth, with one range for all frames."""
    text = f"near; grey: none; one range for all, {unit}"
    return Legend(
        picture_title=picture_title,
        title="Depth",
        low_text="far",
        text=text,
        colors=_colors("depth"),
    )


def confidence_legend(picture_title: str) -> Legend:
    """Return the legend of confidence."""
    return Legend(
        picture_title=picture_title,
        title=picture_title,
        low_text="0",
        text="1: the data alone decide",
        colors=_colors("confidence"),
    )


def deviation_legend(picture_title: str) -> Legend:
    """Return the legend of the relative deviation of depth."""
    low, high = UNCERTAINTY_RANGE
    return Legend(
        picture_title=picture_title,
        title="Deviation of depth",
        low_text=f"{100 * low:g} %",
        text=f"{100 * high:g} % and more; grey: not known",
        colors=_colors("error"),
    )


def flow_legend(picture_title: str, title: str, limit: float) -> Legend:
    """Return the colour wheel of image motion; its rim has a motion of `limit` px/frame."""
    text = f"direction as hue; rim: {limit:.2g} px a frame and more"
    return Legend(
        picture_title=picture_title,
        title=title,
        text=text,
        wheel=png_url(color_wheel(_WHEEL_PIXELS)),
    )


def _colors(quantity: Quantity) -> list[str]:
    return [as_hex(color) for color in color_ramp(quantity)[:: 255 // (_BAR_COLORS - 1)]]
