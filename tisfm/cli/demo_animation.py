"""The animation of the demo: a virtual camera circles before the estimated depth."""

from __future__ import annotations

import io
import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.formats import atomic_write
from tisfm.interpretation import Interpretation
from tisfm.show import color_ramp, depth_grey, inverse_depth_limit

ANIMATION = "demo.webp"
FRAMES = 30
_DURATION = 100  # ms a frame
_QUALITY = 50  # of WebP
_SWING = 0.12  # share of the width: motion of the nearest against the farthest point
_FLATNESS = 0.6  # height of the ellipse over its width
_SHADE = 0.45  # share of the frame's brightness in the colours of depth
_DARKEST = 25  # of 255: colour code of the farthest points, which are not black
_BEHIND = 0.8  # factor of brightness in gaps, which the frame does not show
_STEP = 0.08  # share of the range of nearness: a larger change within 5 px is an edge
_FINE = 2  # samples per pixel side, which a pixel averages
_POINTS = 3  # per pixel side: more than samples, since visible surfaces can be stretched

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]


def write_animation(path: Path, result: Interpretation, *, width: int = 360) -> None:
    """Write an endless animation of the frame in 3D, which fades into colours of depth.

    A virtual camera moves once around an ellipse across its optical axis, and looks at the middle
    of the range of inverse depth. Gaps, which the frame hides, are filled by the farther surface,
    somewhat darker. Near depth has bright colours.

    Parameters
    ----------
    path : Path
        File to write, WebP.
    result : Interpretation
        The frame and its inverse depth.
    width : int, default 360
        Width of the pictures, px.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    first, *others = map(Image.fromarray, animation_frames(result, width=width))
    packed = io.BytesIO()
    first.save(
        packed,
        "WEBP",
        save_all=True,
        append_images=others,
        duration=_DURATION,
        loop=0,
        quality=_QUALITY,
        method=2,
    )
    with atomic_write(path) as file:
        file.write(packed.getvalue())


def animation_frames(result: Interpretation, *, width: int = 360) -> list[Picture]:
    """Return the pictures of `write_animation`, (h, width, 3) each, in the shape of the frame.

    Parameters
    ----------
    result : Interpretation
        The frame and its inverse depth.
    width : int, default 360
        Width of the pictures, px.
    """
    rows, columns = result.inverse_depth.shape
    height = max(1, round(rows * width / columns))
    points = _POINTS * width, _POINTS * height
    limit = inverse_depth_limit(result.inverse_depth) or 1.0
    nearness = np.clip(np.nan_to_num(result.inverse_depth / limit), 0, 1).astype(np.float32)
    larger = cv2.resize(_with_steps(nearness), points, interpolation=cv2.INTER_NEAREST)
    nearness = np.asarray(cv2.medianBlur(larger, 5), np.float32)  # rounds enlarged pixels
    paints = [
        cv2.resize(paint, points, interpolation=cv2.INTER_LINEAR).reshape(-1, 3)
        for paint in _paints(result)
    ]
    order = np.argsort(nearness, axis=None, kind="stable").astype(np.int32)  # far to near
    places = _places(nearness, order, height, width)
    pictures = []
    for number in range(FRAMES):
        turn = 2 * math.pi * number / FRAMES
        seen, behind = _view(places, order, turn, height, width)
        grey, colors = (np.take(paint, seen, axis=0) for paint in paints)
        share = min(1.0, max(0.0, 0.5 - 1.5 * math.cos(turn)))  # weight of the colours
        both = cv2.addWeighted(grey, 1 - share, colors, share, 0)
        both[behind] = (both[behind] * _BEHIND).astype(np.uint8)
        picture = cv2.resize(both, (width, height), interpolation=cv2.INTER_AREA)
        pictures.append(np.asarray(picture, np.uint8))
    return pictures


def _with_steps(nearness: Floats) -> Floats:
    """Make edges steps: points between two surfaces would look like threads between them."""
    around = np.ones((5, 5), np.uint8)
    far, near = cv2.erode(nearness, around), cv2.dilate(nearness, around)
    nearer = np.where(nearness - far < near - nearness, far, near)
    return np.where(near - far > _STEP, nearer, nearness)


def _paints(result: Interpretation) -> tuple[Picture, Picture]:
    """Return the frame, and its depth in colours, shaded by the brightness of the frame."""
    frame = result.frame if result.frame.ndim == 3 else np.dstack([result.frame] * 3)
    codes = np.maximum(depth_grey(result.inverse_depth), _DARKEST)
    colors = color_ramp("depth")[codes]
    light = frame.mean(axis=2, keepdims=True) / max(float(frame.mean()), 1.0)
    shaded = np.clip(colors * (1 - _SHADE + _SHADE * light), 0, 255)
    return frame, shaded.astype(np.uint8)


def _places(
    nearness: Floats, order: NDArray[np.int32], height: int, width: int
) -> tuple[Floats, Floats, Floats]:
    """Return positions of points, right and down, and their motion, in sample units.

    A margin outside the picture comes into view as the camera moves.
    """
    y, x = np.divmod(order, nearness.shape[1])
    scale = _FINE / _POINTS * (1 + 1.1 * _SWING)
    near = nearness.reshape(-1)[order] - 0.5
    x = (x - (nearness.shape[1] - 1) / 2) * scale + _FINE * width / 2
    y = (y - (nearness.shape[0] - 1) / 2) * scale + _FINE * height / 2
    return x.astype(np.float32), y.astype(np.float32), near * (_SWING * _FINE * width)


def _view(
    places: tuple[Floats, Floats, Floats],
    order: NDArray[np.int32],
    turn: float,
    height: int,
    width: int,
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the visible point at each sample, and the mask of gaps.

    A gap has the farther one of the two points beside it in its row.
    """
    x, y, move = places
    high, wide = _FINE * height + 2, _FINE * width + 2  # with a rim for points outside
    column = np.clip(x + move * np.float32(math.cos(turn)) + 1, 0, wide - 1).astype(np.int32)
    row = np.clip(y + move * np.float32(_FLATNESS * math.sin(turn)) + 1, 0, high - 1)
    rank = np.full(high * wide, -1, np.int32)  # of the visible point, in the order from far to near
    rank[row.astype(np.int32) * wide + column] = np.arange(len(order), dtype=np.int32)
    rank = rank.reshape(high, wide)[1:-1, 1:-1]
    gap = rank < 0
    along = np.arange(wide - 2, dtype=np.int32)
    left = np.maximum.accumulate(np.where(gap, -1, along), axis=1)
    right = np.minimum.accumulate(np.where(gap, wide - 2, along)[:, ::-1], axis=1)[:, ::-1]
    right = np.where(right > wide - 3, left, right)
    left = np.where(left < 0, right, left)
    farther = np.minimum(*(np.take_along_axis(rank, end, axis=1) for end in (left, right)))
    return order[np.maximum(farther, 0)], gap
