"""Colours of pixels by what is looked at, and what the colours mean."""

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ViewFrame
from tisfm.show import (
    UNCERTAINTY_RANGE,
    UNKNOWN_COLOR,
    color_ramp,
    confidence_to_color,
    depth_to_color,
    error_to_color,
    label_colors,
)
from tisfm.show.palette import as_hex

Quantity = Literal["image", "depth", "confidence", "deviation", "object"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
_RAMPS: dict[str, Literal["depth", "confidence", "error"]] = {
    "depth": "depth",
    "confidence": "confidence",
    "deviation": "error",
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
        return depth_to_color(frame.inverse_depth, limit=frame.scale * ranges.inverse_depth)
    if quantity == "confidence" and frame.confidence is not None:
        return confidence_to_color(frame.confidence)
    if quantity == "deviation" and frame.relative_deviation is not None:
        deviation = frame.relative_deviation
        known = np.where(np.isfinite(deviation), deviation, np.nan)
        return error_to_color(known, limits=UNCERTAINTY_RANGE)
    if quantity == "object" and frame.labels is not None:
        grey = cv2.cvtColor(frame.picture, cv2.COLOR_RGB2GRAY)[..., None].astype(np.float32)
        own = label_colors(int(frame.labels.max()) + 1)[frame.labels]
        cover = np.where(frame.labels > 0, 0.75, 0.0).astype(np.float32)[..., None]
        return np.rint((1 - cover) * grey + cover * own).astype(np.uint8)
    if quantity == "image":
        return frame.picture
    return unknown_picture(frame.shape)


def unknown_picture(shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a picture of which nothing is known, (H, W, 3)."""
    return np.full((*shape, 3), UNKNOWN_COLOR, np.uint8)


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
        own = label_colors(max(things, default=0) + 1)
        names = ("at rest", *(f"thing {k}" for k in things))
        shown = [as_hex(own[k]) for k in (0, *things)]
        return Legend(title="object", colors=tuple(shown), ticks=names, is_bar=False)
    bar = color_ramp(_RAMPS[quantity])[:: 255 // (_STOPS - 1)]
    if quantity == "depth":
        top = ranges.inverse_depth or 1.0
        title, ticks = f"depth Z, {unit}", ["∞", f"{2 / top:.3g}", f"{1 / top:.3g}"]
    elif quantity == "confidence":
        title, ticks = "confidence", ["0", "0.5", "1"]
    else:
        low, high = UNCERTAINTY_RANGE
        title = "relative deviation of depth"
        ticks = [f"{100 * share:.3g} %" for share in (low, (low * high) ** 0.5, high)]
    return Legend(title=title, colors=tuple(map(as_hex, bar)), ticks=tuple(ticks), is_bar=True)
