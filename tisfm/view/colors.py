"""Colours of points and pictures of a frame by a quantity; ranges and legends of these colours."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ResultFrame
from tisfm.results.result_frames import FrameCache, ResultFrames
from tisfm.show import (
    UNCERTAINTY_RANGE,
    UNKNOWN_COLOR,
    anaglyph,
    color_ramp,
    confidence_to_color,
    depth_to_color,
    error_to_color,
    flow_to_color,
    inverse_depth_limit,
    label_colors,
    usual_length,
)
from tisfm.show.palette import as_hex

Quantity = Literal["image", "depth", "confidence", "deviation", "object"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
_RAMPS: dict[str, Literal["depth", "confidence", "error"]] = {
    "depth": "depth",
    "confidence": "confidence",
    "deviation": "error",
}
_BAR_COLORS = 9  # colours of a bar, between which the browser interpolates; set by hand
_LABEL_OPACITY = 0.75  # share of the colour of a moving object over the grey picture; set by hand


@dataclass(frozen=True, kw_only=True)
class Legend:
    """The legend of colours."""

    title: str  # quantity and unit
    colors: tuple[str, ...]  # ``#rrggbb``, along a bar or one for each of `ticks`
    ticks: tuple[str, ...]  # values along the bar, or the name of each colour
    is_bar: bool


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Ranges of colours, the same for all frames, so that pictures do not flicker."""

    inverse_depth: float  # inverse depth of the nearest colour, in the scale of the scene
    flow: float  # motion of the fastest colour, px


def pixel_colors(frame: ResultFrame, quantity: Quantity, ranges: Ranges) -> NDArray[np.uint8]:
    """Return a colour for every pixel of a frame, (H, W, 3) uint8; grey if unknown."""
    if quantity == "depth":
        return depth_to_color(frame.inverse_depth, limit=frame.scale * ranges.inverse_depth)
    if quantity == "confidence" and frame.confidence is not None:
        return confidence_to_color(frame.confidence)
    if quantity == "deviation" and frame.relative_deviation is not None:
        deviation = frame.relative_deviation
        positive_values = np.where(np.isfinite(deviation), deviation, np.nan)
        return error_to_color(positive_values, limits=UNCERTAINTY_RANGE)
    if quantity == "object" and frame.labels is not None:
        grey = cv2.cvtColor(frame.picture, cv2.COLOR_RGB2GRAY)[..., None].astype(np.float32)
        label_color = label_colors(int(frame.labels.max()) + 1)[frame.labels]
        opacity = np.where(frame.labels > 0, _LABEL_OPACITY, 0.0).astype(np.float32)[..., None]
        return np.rint((1 - opacity) * grey + opacity * label_color).astype(np.uint8)
    if quantity == "image":
        return frame.picture
    return unknown_picture(frame.shape)


def unknown_picture(shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a picture of unknown pixels, (H, W, 3)."""
    return np.full((*shape, 3), UNKNOWN_COLOR, np.uint8)


def legend_of_result(
    result: ResultFrames,
    quantity: Quantity,
    ranges: Ranges,
    labels: set[int],  # visible labels, for a result without a list of moving objects
) -> Legend | None:
    """Return the legend of a quantity of a result; None for the colours of the image."""
    legend_labels = tuple(moving_object.id for moving_object in result.objects) or tuple(
        sorted(labels)
    )
    unit = result.unit if result.has_one_scale else "harmonic mean depths of the frame"
    return legend(quantity, ranges, unit, legend_labels)


def object_labels(frame: ResultFrame) -> set[int]:
    """Return the labels of the moving objects in a frame."""
    return set() if frame.labels is None else {int(k) for k in np.unique(frame.labels) if k}


def legend(
    quantity: Quantity,
    ranges: Ranges,
    unit: str,  # unit of depth, in words
    labels: tuple[int, ...] = (),  # labels of moving objects
) -> Legend | None:
    """Return the legend of a quantity; None for the colours of the image."""
    if quantity == "image":
        return None
    if quantity == "object":
        label_color = label_colors(max(labels, default=0) + 1)
        names = ("at rest", *(f"object {k}" for k in labels))
        colors = [as_hex(label_color[k]) for k in (0, *labels)]
        return Legend(title="object", colors=tuple(colors), ticks=names, is_bar=False)
    bar = color_ramp(_RAMPS[quantity])[:: 255 // (_BAR_COLORS - 1)]
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


def ranges_of(frames: Sequence[ResultFrame], *, with_flow: bool = True) -> Ranges:
    """Return the median ranges of frames; 1 for a quantity that no frame has."""
    depths = [inverse_depth_limit(frame.inverse_depth) / frame.scale for frame in frames]
    flows = [frame.flow for frame in frames] if with_flow else []
    lengths = [usual_length(flow) for flow in flows if flow is not None]
    return Ranges(inverse_depth=_median(depths), flow=_median(lengths))


def are_different(ranges0: Ranges, ranges1: Ranges, factor: float) -> bool:
    """Return whether depth or motion ranges differ by more than a factor."""
    pairs = (ranges0.inverse_depth, ranges1.inverse_depth), (ranges0.flow, ranges1.flow)
    return any(max(pair) > factor * min(pair) for pair in pairs)


def sample_frames(cache: FrameCache, count: int, samples: int = 3) -> list[ResultFrame]:
    """Return a few readable frames, spread evenly over `count` frames."""
    frames = []
    for number in dict.fromkeys(int(k) for k in np.linspace(0, count - 1, samples)):
        try:
            frames.append(cache[number])
        except (OSError, ValueError):
            continue
    return frames


def _median(values: list[float]) -> float:
    """Return the median of the positive values; 1 without any."""
    positive_values = [value for value in values if value > 0]
    return float(np.median(positive_values)) if positive_values else 1.0


PictureKind = Literal["frame", "depth", "flow", "anaglyph", "confidence", "deviation", "object"]
KINDS: tuple[PictureKind, ...] = get_args(PictureKind)
_CROSS_COLOR = (230, 159, 0)  # of the cross at a marked pixel


def picture_of(
    frame: ResultFrame,
    kind: PictureKind,  # one of `KINDS`; unknown pixels are grey
    ranges: Ranges,
    *,
    width: int,  # largest width, px
    marked_pixel: tuple[int, int] | None = None,  # row and column of the pixel to mark by a cross
) -> NDArray[np.uint8]:
    """Return a picture of a frame, (h, w, 3) uint8, of a limited width.

    Small pictures are enlarged by a whole number.
    """
    picture = _picture(frame, kind, ranges)
    height, original_width = picture.shape[:2]
    if original_width > width:
        size = (width, max(1, round(height * width / original_width)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    elif width >= 2 * original_width:
        enlarged = picture.repeat(width // original_width, axis=0).repeat(
            width // original_width, axis=1
        )
        picture = enlarged
    picture = np.ascontiguousarray(picture)
    if marked_pixel is not None:
        scale = picture.shape[1] / original_width
        center = (int((marked_pixel[1] + 0.5) * scale), int((marked_pixel[0] + 0.5) * scale))
        picture = picture.copy()
        for color, thickness in (((0, 0, 0), 4), (_CROSS_COLOR, 2)):
            cv2.drawMarker(picture, center, color, cv2.MARKER_CROSS, 17, thickness)
    return picture


def caption(kind: PictureKind, ranges: Ranges) -> str:
    """Return the meaning of the colours of a picture."""
    captions = {
        "depth": f"near is bright, brightest at a depth of {1 / ranges.inverse_depth:.3g}",
        "flow": f"direction as hue, full colour at {ranges.flow:.3g} px",
        "anaglyph": "for red-cyan glasses",
        "confidence": "blue 0, yellow 1",
        "deviation": "dark 1 %, yellow 64 %, grey unknown",
    }
    return captions.get(kind, "")


def _picture(frame: ResultFrame, kind: PictureKind, ranges: Ranges) -> NDArray[np.uint8]:
    if kind == "frame":
        return frame.picture
    if kind == "flow":
        if frame.flow is None:
            return unknown_picture(frame.shape)
        return flow_to_color(frame.flow, limit=ranges.flow or None, beyond="same")
    if kind == "anaglyph":
        limit = ranges.inverse_depth * frame.scale
        return anaglyph(frame.picture, frame.inverse_depth, limit=limit or None)
    return pixel_colors(frame, kind, ranges)
