"""Pictures inside a page: small, and never larger in all than a page may be."""

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.show.arrays import as_rgb, as_uint8

MOST_SLIDES = 48
LONGEST_SIDE = 560  # px
BUDGET = 13_000_000  # bytes of all pictures; a third more as text, which stays below 20 MB
_QUALITIES = (86, 75, 60, 40, 20)


class Pictures:
    """Makes pictures of so many bytes each at most, that all together keep the budget.

    Parameters
    ----------
    count : int
        How many there will be.
    budget : int
        Bytes of all of them.
    """

    def __init__(self, count: int, *, budget: int = BUDGET) -> None:
        self._most = budget // max(count, 1)

    def url(self, picture: NDArray[np.generic]) -> str:
        """Return a picture, (H, W) or (H, W, 3), as the address of an image that contains it."""
        (levels,) = as_uint8(picture)
        image = Image.fromarray(np.ascontiguousarray(as_rgb(levels)))
        side = LONGEST_SIDE
        while True:
            small = image.copy()
            small.thumbnail((side, side), Image.Resampling.BOX)
            for quality in _QUALITIES:
                data = io.BytesIO()
                small.save(data, "JPEG", quality=quality, subsampling=0)
                if data.tell() <= self._most or side <= 8:
                    return _address("jpeg", data.getvalue())
            side //= 2


def png_url(picture: NDArray[np.uint8]) -> str:
    """Return a small drawing, such as a legend, as the address of an image that contains it."""
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "PNG", optimize=True)
    return _address("png", data.getvalue())


def chosen(count: int, wanted: list[int], most: int = MOST_SLIDES) -> list[int]:
    """Return the numbers of the frames that are shown: some that are wanted, others evenly.

    Parameters
    ----------
    count : int
        Frames.
    wanted : list of int
        Those to be shown for sure, such as the first of each status, the most wanted first; at most
        half of `most` are.
    most : int
        How many are shown.
    """
    if count <= most:
        return list(range(count))
    kept = list(dict.fromkeys(wanted))[: most // 2]
    others = most - len(kept)
    even = {round(k * (count - 1) / (others - 1)) for k in range(others)}
    return sorted({*kept, *even})


def _address(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
