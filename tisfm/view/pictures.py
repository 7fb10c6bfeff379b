"""Pictures beside the scene: the frame, depth, motion, an anaglyph."""

from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ResultFrame
from tisfm.show import anaglyph, flow_to_color
from tisfm.view.colors import Ranges, pixel_colors, unknown_picture

PictureKind = Literal["frame", "depth", "flow", "anaglyph", "confidence", "deviation", "object"]
KINDS: tuple[PictureKind, ...] = get_args(PictureKind)
_CROSS = (230, 159, 0)  # colour of the mark of a pixel


def picture_of(
    frame: ResultFrame,
    kind: PictureKind,  # one of `KINDS`; unknown pixels are grey
    ranges: Ranges,
    *,
    width: int,  # largest width, px
    marked: tuple[int, int] | None = None,  # row and column of the pixel to mark by a cross
) -> NDArray[np.uint8]:
    """Return a picture of a frame, (h, w, 3) uint8, of a limited width.

    Small pictures are enlarged by a whole number.
    """
    picture = _picture(frame, kind, ranges)
    height, full = picture.shape[:2]
    if full > width:
        size = (width, max(1, round(height * width / full)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    elif width >= 2 * full:
        enlarged = picture.repeat(width // full, axis=0).repeat(width // full, axis=1)
        picture = enlarged
    picture = np.ascontiguousarray(picture)
    if marked is not None:
        share = picture.shape[1] / full
        center = (int((marked[1] + 0.5) * share), int((marked[0] + 0.5) * share))
        picture = picture.copy()
        for color, thickness in (((0, 0, 0), 4), (_CROSS, 2)):
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
