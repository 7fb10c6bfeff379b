"""Masks of used pixels in both frames at every pyramid level, and filling of ignored pixels.

Ignored pixels give no data. They are filled from their surroundings, so that smoothing and the
stencils of neighbouring pixels do not see the edges of an object that covers the scene.
"""

from copy import copy
from functools import cached_property

import cv2
import numpy as np

from tisfm.solver.sampling import goes_to

RIM = 3  # px of a level: side of the square around a used pixel that has no ignored pixel
MOST_IGNORED = 0.5  # share of a coarse pixel's area that may be ignored


class PixelMasks:
    """The used pixels of a pair, at every level of the pyramid."""

    def __init__(
        self,
        # counted0, counted1: (H, W) bool, used pixels of each frame
        counted0: np.ndarray,
        counted1: np.ndarray,
        # height and width of every level, the finest first, px
        shapes: list[tuple[int, int]],
    ) -> None:
        self.whole = counted0, counted1
        self._shapes = shapes

    @cached_property
    def levels(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The pixels of both frames, (h, w) bool, whose stencils have used pixels only."""
        first, second = (
            [_on_level(counted, shape) for shape in self._shapes] for counted in self.whole
        )
        return list(zip(first, second, strict=True))

    def missing(
        self,
        flow: np.ndarray,  # (2, h, w) float32: px/frame of the level
        level: int | None = None,  # by default the finest, with the masks as given
    ) -> np.ndarray:  # (h, w) bool
        """Return the pixels that are ignored, or move to an ignored pixel of frame 1."""
        counted0, counted1 = self.whole if level is None else self.levels[level]
        return ~(counted0 & counted1[goes_to(flow)])

    def reversed(self) -> "PixelMasks":
        """Return the masks with both frames exchanged."""
        return PixelMasks(*self.whole[::-1], self._shapes)

    def coarser(self, level: int) -> "PixelMasks":
        """Return the masks of `level`, as the finest level, and of all coarser levels."""
        other = copy(self)
        other.whole, other._shapes = self.levels[level], self._shapes[level:]
        other.levels = self.levels[level:]
        return other


def filled(
    image: np.ndarray,  # (H, W) float32
    ignored: np.ndarray,  # (H, W) bool
) -> np.ndarray:  # (H, W) float32: 0 if all pixels are ignored
    """Return an image whose ignored pixels are means of used pixels, farther inside over more."""
    if ignored.all():
        return np.zeros_like(image)
    weight = (~ignored).astype(np.float32)
    seen = image[~ignored]
    # Without the clipping, rounding would give a uniform image a texture.
    return _filled(image, weight).clip(seen.min(), seen.max())


def _filled(image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return an image whose pixels of weight 0 are means of their surroundings."""
    if weight.all():
        return image
    height, width = image.shape
    size = (-(-width // 2), -(-height // 2))
    coarse, total = (
        cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (image * weight, weight)
    )
    np.divide(coarse, total, out=coarse, where=total > 0)
    coarse = _filled(coarse, (total > 0).astype(np.float32))
    around = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.where(weight > 0, image, around)


def _on_level(counted: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the pixels of a level that are used and have used pixels only around them."""
    size = shape[::-1]
    share = cv2.resize(counted.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    within = (share > 1 - MOST_IGNORED).astype(np.uint8)
    return cv2.erode(within, np.ones((RIM, RIM), np.uint8)) > 0
