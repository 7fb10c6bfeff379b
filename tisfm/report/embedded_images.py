"""Pictures inside a page, limited in size so that the page stays small."""

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.show.arrays import as_rgb, as_uint8

# Set by hand.
MAX_SLIDES = 48
MAX_SIDE = 560  # px
BUDGET = 13_000_000  # bytes of all pictures; base64 adds a third, and the page stays below 20 MB
_QUALITIES = (86, 75, 60, 40, 20)  # of JPEG, in the order of trial


class Pictures:
    """Makes pictures whose bytes together stay within a budget."""

    def __init__(
        self,
        count: int,  # number of pictures
        *,
        budget: int = BUDGET,  # bytes of all pictures
    ) -> None:
        self._max_bytes = budget // max(count, 1)

    def url(self, picture: NDArray[np.generic]) -> str:
        """Return a picture, (H, W) or (H, W, 3), as a data address with a JPEG."""
        (levels,) = as_uint8(picture)
        image = Image.fromarray(np.ascontiguousarray(as_rgb(levels)))
        side = MAX_SIDE
        while True:
            small = image.copy()
            small.thumbnail((side, side), Image.Resampling.BOX)
            for quality in _QUALITIES:
                data = io.BytesIO()
                small.save(data, "JPEG", quality=quality, subsampling=0)
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
    # `most`
    wanted: list[int],
    most: int = MAX_SLIDES,  # limit of the frames to show
) -> list[int]:
    """Return the numbers of the frames to show: required frames, and others evenly spread."""
    if count <= most:
        return list(range(count))
    kept = list(dict.fromkeys(wanted))[: most // 2]
    others = most - len(kept)
    even = {round(k * (count - 1) / (others - 1)) for k in range(others)}
    return sorted({*kept, *even})


def _address(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
