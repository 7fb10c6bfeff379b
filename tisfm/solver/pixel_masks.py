"""Masks of used pixels in both frames at every pyramid level, and filling of ignored pixels.

Ignored pixels give no data. They are filled from their surroundings, so that smoothing and the
stencils of neighbouring pixels do not see the edges of an object that covers the scene.
"""

from copy import copy
from functools import cached_property

import cv2
import numpy as np

from tisfm.solver.sampling import target_pixels

USED_SQUARE = 3  # px of a level: side of the square around a used pixel without ignored pixels
MAX_IGNORED_SHARE = 0.5  # share of a coarse pixel's area that may be ignored


class PixelMasks:
    """The used pixels of a pair, at every level of the pyramid."""

    def __init__(
        self,
        # valid0, valid1: (H, W) bool, used pixels of each frame
        valid0: np.ndarray,
        valid1: np.ndarray,
        # height and width of every level, the finest first, px
        shapes: list[tuple[int, int]],
    ) -> None:
        self.original = valid0, valid1
        self._shapes = shapes

    @cached_property
    def levels(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Pixels of both frames, (h, w) bool, whose stencils contain used pixels only."""
        first, second = (
            [_resize_mask(valid, shape) for shape in self._shapes] for valid in self.original
        )
        return list(zip(first, second, strict=True))

    def ignored_pixels(
        self,
        flow: np.ndarray,  # (2, h, w) float32: px/frame of the level
        level: int | None = None,  # by default the finest level, with the original masks
    ) -> np.ndarray:  # (h, w) bool
        """Return the pixels that are ignored, or move to an ignored pixel of frame 1."""
        valid0, valid1 = self.original if level is None else self.levels[level]
        return ~(valid0 & valid1[target_pixels(flow)])

    def reversed(self) -> "PixelMasks":
        """Return the masks with both frames exchanged."""
        return PixelMasks(*self.original[::-1], self._shapes)

    def coarser(self, level: int) -> "PixelMasks":
        """Return the masks of `level`, as the finest level, and of all coarser levels."""
        coarser_masks = copy(self)
        coarser_masks.original, coarser_masks._shapes = self.levels[level], self._shapes[level:]
        coarser_masks.levels = self.levels[level:]
        return coarser_masks


def fill_ignored(
    image: np.ndarray,  # (H, W) float32
    ignored: np.ndarray,  # (H, W) bool
) -> np.ndarray:  # (H, W) float32: 0 if all pixels are ignored
    """Return an image whose ignored pixels are means of used pixels around them.

    The mean of a pixel farther inside an ignored region is over more used pixels.
    """
    if ignored.all():
        return np.zeros_like(image)
    weight = (~ignored).astype(np.float32)
    used_values = image[~ignored]
    # Without the clipping, rounding would give a uniform image a texture.
    return _fill(image, weight).clip(used_values.min(), used_values.max())


def _fill(image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return an image whose pixels of weight 0 are means of their surroundings."""
    if weight.all():
        return image
    height, width = image.shape
    size = (-(-width // 2), -(-height // 2))
    coarse, total = (
        cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (image * weight, weight)
    )
    np.divide(coarse, total, out=coarse, where=total > 0)
    coarse = _fill(coarse, (total > 0).astype(np.float32))
    surroundings = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.where(weight > 0, image, surroundings)


def _resize_mask(valid: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the used pixels of a level that have only used pixels around them."""
    size = shape[::-1]
    share = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    is_used = (share > 1 - MAX_IGNORED_SHARE).astype(np.uint8)
    return cv2.erode(is_used, np.ones((USED_SQUARE, USED_SQUARE), np.uint8)) > 0
