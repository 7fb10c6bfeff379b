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
_FRAME_DURATION = 100  # ms a frame
_QUALITY = 50  # of WebP
_SWING_WIDTH = 0.12  # share of the width: motion of the nearest point against the farthest
_ELLIPSE_RATIO = 0.6  # height of the ellipse divided by its width
_SHADING = 0.45  # share of the frame's brightness in the colours of depth
_MIN_COLOR_CODE = 25  # of 255: colour code of the farthest points, which are not black
_GAP_BRIGHTNESS = 0.8  # factor of brightness in gaps, which the frame does not show
_MIN_EDGE_STEP = 0.08  # share of the range of nearness: a larger change within 5 px is an edge
_SAMPLES_PER_PIXEL = 2  # per pixel side; a pixel is the mean of its samples
_POINTS_PER_PIXEL = 3  # per pixel side: more than samples, because the motion stretches surfaces

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
        duration=_FRAME_DURATION,
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
    points = _POINTS_PER_PIXEL * width, _POINTS_PER_PIXEL * height
    limit = inverse_depth_limit(result.inverse_depth) or 1.0
    nearness = np.clip(np.nan_to_num(result.inverse_depth / limit), 0, 1).astype(np.float32)
    enlarged = cv2.resize(_sharpen_edges(nearness), points, interpolation=cv2.INTER_NEAREST)
    nearness = np.asarray(cv2.medianBlur(enlarged, 5), np.float32)  # rounds enlarged pixels
    images = [
        cv2.resize(image, points, interpolation=cv2.INTER_LINEAR).reshape(-1, 3)
        for image in _paint_images(result)
    ]
    order = np.argsort(nearness, axis=None, kind="stable").astype(np.int32)  # far to near
    positions = _point_positions(nearness, order, height, width)
    pictures = []
    for number in range(FRAMES):
        phase = 2 * math.pi * number / FRAMES
        visible_points, is_gap = _view(positions, order, phase, height, width)
        grey, colors = (np.take(image, visible_points, axis=0) for image in images)
        share = min(1.0, max(0.0, 0.5 - 1.5 * math.cos(phase)))  # weight of the colours
        blended = cv2.addWeighted(grey, 1 - share, colors, share, 0)
        blended[is_gap] = (blended[is_gap] * _GAP_BRIGHTNESS).astype(np.uint8)
        picture = cv2.resize(blended, (width, height), interpolation=cv2.INTER_AREA)
        pictures.append(np.asarray(picture, np.uint8))
    return pictures


def _sharpen_edges(nearness: Floats) -> Floats:
    """Make edges sharp: points between two surfaces would look like threads between them."""
    window = np.ones((5, 5), np.uint8)
    far, near = cv2.erode(nearness, window), cv2.dilate(nearness, window)
    nearest_surface = np.where(nearness - far < near - nearness, far, near)
    return np.where(near - far > _MIN_EDGE_STEP, nearest_surface, nearness)


def _paint_images(result: Interpretation) -> tuple[Picture, Picture]:
    """Return the frame, and its depth in colours, shaded by the brightness of the frame."""
    frame = result.frame if result.frame.ndim == 3 else np.dstack([result.frame] * 3)
    codes = np.maximum(depth_grey(result.inverse_depth), _MIN_COLOR_CODE)
    colors = color_ramp("depth")[codes]
    light = frame.mean(axis=2, keepdims=True) / max(float(frame.mean()), 1.0)
    shaded = np.clip(colors * (1 - _SHADING + _SHADING * light), 0, 255)
    return frame, shaded.astype(np.uint8)


def _point_positions(
    nearness: Floats, order: NDArray[np.int32], height: int, width: int
) -> tuple[Floats, Floats, Floats]:
    """Return positions of points, right and down, and their motion, in sample units.

    A margin outside the picture comes into view as the camera moves.
    """
    y, x = np.divmod(order, nearness.shape[1])
    scale = _SAMPLES_PER_PIXEL / _POINTS_PER_PIXEL * (1 + 1.1 * _SWING_WIDTH)
    near = nearness.reshape(-1)[order] - 0.5
    x = (x - (nearness.shape[1] - 1) / 2) * scale + _SAMPLES_PER_PIXEL * width / 2
    y = (y - (nearness.shape[0] - 1) / 2) * scale + _SAMPLES_PER_PIXEL * height / 2
    return (
        x.astype(np.float32),
        y.astype(np.float32),
        near * (_SWING_WIDTH * _SAMPLES_PER_PIXEL * width),
    )


def _view(
    positions: tuple[Floats, Floats, Floats],
    order: NDArray[np.int32],
    phase: float,
    height: int,
    width: int,
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the visible point at each sample, and the mask of gaps.

    A gap gets the farther of the two points beside it in its row.
    """
    x, y, motion = positions
    # with a rim for points outside
    padded_height, padded_width = _SAMPLES_PER_PIXEL * height + 2, _SAMPLES_PER_PIXEL * width + 2
    column = np.clip(x + motion * np.float32(math.cos(phase)) + 1, 0, padded_width - 1).astype(
        np.int32
    )
    row = np.clip(
        y + motion * np.float32(_ELLIPSE_RATIO * math.sin(phase)) + 1, 0, padded_height - 1
    )
    rank = np.full(
        padded_height * padded_width, -1, np.int32
    )  # of the visible point, in the order from far to near
    rank[row.astype(np.int32) * padded_width + column] = np.arange(len(order), dtype=np.int32)
    rank = rank.reshape(padded_height, padded_width)[1:-1, 1:-1]
    is_gap = rank < 0
    columns = np.arange(padded_width - 2, dtype=np.int32)
    left = np.maximum.accumulate(np.where(is_gap, -1, columns), axis=1)
    right = np.minimum.accumulate(np.where(is_gap, padded_width - 2, columns)[:, ::-1], axis=1)[
        :, ::-1
    ]
    right = np.where(right > padded_width - 3, left, right)
    left = np.where(left < 0, right, left)
    farther_rank = np.minimum(*(np.take_along_axis(rank, end, axis=1) for end in (left, right)))
    return order[np.maximum(farther_rank, 0)], is_gap
