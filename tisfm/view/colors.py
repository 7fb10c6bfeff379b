"""Colours of pixels by what is looked at, and what the colours mean."""

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.show import UNCERTAINTY_RANGE, label_colors
from tisfm.view.frame import ViewFrame

Quantity = Literal["image", "depth", "confidence", "deviation", "object"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
_NOTHING = 150  # grey, where nothing is known
# Colours that people tell apart however they see them (Okabe and Ito, 2002); what is at rest first.
_THINGS = np.array(
    [(170, 170, 170), (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178),
     (213, 94, 0), (204, 121, 167)],
    np.uint8,
)  # fmt: skip
_MAPS = {
    "depth": cv2.COLORMAP_INFERNO,
    "confidence": cv2.COLORMAP_CIVIDIS,
    "deviation": cv2.COLORMAP_VIRIDIS,
}
_STOPS = 9  # of the bar of a legend


@dataclass(frozen=True, kw_only=True)
class Legend:
    """What colours mean.

    Attributes
    ----------
    title : str
        The quantity and its unit.
    colors : tuple of str
        ``#rrggbb``, along a bar or one for each of `ticks`.
    ticks : tuple of str
        What they stand for: at both ends and between, or one for each colour.
    is_bar : bool
    """

    title: str
    colors: tuple[str, ...]
    ticks: tuple[str, ...]
    is_bar: bool


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Ranges of colours and pictures, the same for all frames, or they would flicker.

    Attributes
    ----------
    inverse_depth : float
        What is shown as nearest, in the scale of the scene.
    flow : float
        What is shown as fastest, px.
    """

    inverse_depth: float
    flow: float


def pixel_colors(frame: ViewFrame, quantity: Quantity, ranges: Ranges) -> NDArray[np.uint8]:
    """Return a colour for every pixel of a frame, (H, W, 3) uint8.

    Grey where the quantity is not known.
    """
    if quantity == "depth":
        share = frame.inverse_depth / np.float32(frame.scale * ranges.inverse_depth or 1)
        return _mapped(share, quantity)
    if quantity == "confidence" and frame.confidence is not None:
        return _mapped(frame.confidence, quantity)
    if quantity == "deviation" and frame.relative_deviation is not None:
        low, high = UNCERTAINTY_RANGE
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.log(frame.relative_deviation / low) / np.log(high / low)
        return _mapped(share, quantity)
    if quantity == "object" and frame.labels is not None:
        grey = cv2.cvtColor(frame.picture, cv2.COLOR_RGB2GRAY)[..., None].astype(np.float32)
        own = thing_colors(int(frame.labels.max()) + 1)[frame.labels]
        cover = np.where(frame.labels > 0, 0.75, 0.0).astype(np.float32)[..., None]
        return np.rint((1 - cover) * grey + cover * own).astype(np.uint8)
    if quantity == "image":
        return frame.picture
    return np.full((*frame.shape, 3), _NOTHING, np.uint8)


def thing_colors(count: int) -> NDArray[np.uint8]:
    """Return a colour for each of so many labels, (count, 3) uint8; 0 is what is at rest."""
    more = label_colors(max(count, 1))
    return np.concatenate([_THINGS, more[len(_THINGS) :]])[:count]


def legend(
    quantity: Quantity, ranges: Ranges, unit: str, things: tuple[int, ...] = ()
) -> Legend | None:
    """Return what the colours of a quantity mean; None for those of the image.

    Parameters
    ----------
    quantity : str
    ranges : Ranges
    unit : str
        Of depth, in words.
    things : tuple of int
        Labels that are seen.
    """
    if quantity == "image":
        return None
    if quantity == "object":
        own = thing_colors(max(things, default=0) + 1)
        names = ("at rest", *(f"thing {k}" for k in things))
        shown = ["#c8c8c8", *(_hex(own[k]) for k in things)]
        return Legend(title="object", colors=tuple(shown), ticks=names, is_bar=False)
    bar = _mapped(np.linspace(0, 1, _STOPS, dtype=np.float32)[None], quantity)[0]
    if quantity == "depth":
        top = ranges.inverse_depth or 1.0
        title, ticks = f"depth Z, {unit}", ["∞", f"{2 / top:.3g}", f"{1 / top:.3g}"]
    elif quantity == "confidence":
        title, ticks = "confidence", ["0", "0.5", "1"]
    else:
        low, high = UNCERTAINTY_RANGE
        title = "relative deviation of depth"
        ticks = [f"{100 * share:.3g} %" for share in (low, (low * high) ** 0.5, high)]
    return Legend(title=title, colors=tuple(map(_hex, bar)), ticks=tuple(ticks), is_bar=True)


def _mapped(share: ArrayLike, quantity: str) -> NDArray[np.uint8]:
    """Return colours of a map, from 0 to 1; grey where there is no number."""
    values = np.asarray(share, np.float32)
    known = np.isfinite(values)
    codes = np.zeros(values.shape, np.float32)
    np.clip(values, 0, 1, out=codes, where=known)
    mapped = cv2.applyColorMap(np.rint(255 * codes).astype(np.uint8), _MAPS[quantity])
    colors: NDArray[np.uint8] = cv2.cvtColor(mapped, cv2.COLOR_BGR2RGB)  # type: ignore[assignment]
    colors[~known] = _NOTHING
    return colors


def _hex(color: NDArray[np.uint8]) -> str:
    return "#" + bytes(color.tolist()).hex()
