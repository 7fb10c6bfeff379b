"""The image pyramids of both frames of a pair, and the splines of the second frame."""

import math
from collections.abc import Callable
from copy import copy
from functools import cache, partial

import cv2
import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.solver.pixel_masks import PixelMasks
from tisfm.solver.sampling import spline_taps
from tisfm.solver.smoothness import mean_step
from tisfm.threads import start_in_second_thread

COARSEST_FRAME_SIDE = 12  # px: the shorter side of the coarsest frames is at least as long
MIN_PARALLEL_PIXELS = 1 << 16  # pixels of the smallest frame for which a second thread saves time


class ImagePyramid:
    """Both frames at every level; level 0 is the finest."""

    def __init__(
        self,
        # grey0, grey1: (H, W) float32, grey levels on the 8-bit scale
        grey0: np.ndarray,
        grey1: np.ndarray,
        camera: Camera,  # pinhole camera of the finest level
        *,
        factor: float,  # ratio of neighbouring levels' sampling densities, in [0.5, 1)
        levels: int | None = None,  # most levels; None: as many as `COARSEST_FRAME_SIDE` allows
        presmoothing: float = 0.0,  # standard deviation of a Gaussian applied first, px
        # last level of coarse-to-fine estimation; the coarsest level in a pyramid of fewer levels
        last: int = 0,
        # pixels of each frame that are used, (H, W) bool, by default all; ignored pixels must
        # already be filled from their surroundings
        valid: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        self.factor = factor
        if grey0.min() == grey0.max() and grey1.min() == grey1.max():
            # Otherwise rounding errors of the uniform frames would be the only data.
            grey0, grey1 = np.zeros_like(grey0), np.zeros_like(grey1)
        height, width = self.shape = grey0.shape  # of the finest level, px
        count = self.levels = level_count(height, width, factor, levels)
        self.last = min(last, count - 1)
        # sampling density of every level relative to the finest
        self.scales = [factor**level for level in range(count)]
        self.cameras = [camera] + [camera.scaled(s, height, width) for s in self.scales[1:]]

        def build_frames(grey: np.ndarray) -> list[np.ndarray]:
            return gaussian_pyramid(smooth(grey, presmoothing), factor, count)

        is_parallel = runtime.threads() > 1 and grey0.size >= MIN_PARALLEL_PIXELS
        if is_parallel:
            # OpenCV's filters and kernels on coarse levels use one thread each.
            wait_for_frames1 = start_in_second_thread(build_frames, grey1)
            self.frames0, self.frames1 = build_frames(grey0), wait_for_frames1()
        else:
            self.frames0, self.frames1 = build_frames(grey0), build_frames(grey1)
        self._spline1 = [self._spline(level) for level in range(count)]
        if is_parallel:
            for level in reversed(range(self.last, count)):  # the coarsest level is needed first
                self._spline1[level] = start_in_second_thread(spline_taps, self.frames1[level])
        self.masks: PixelMasks | None = None  # the used pixels; None if all are used
        if valid is not None:
            self.masks = PixelMasks(
                *valid, [(len(frame), frame.shape[1]) for frame in self.frames0]
            )
        # mean |ΔI| between neighbours of frame 0 at the finest level
        self.contrast = mean_step(self.frames0[0], self.valid0(0))

    def valid_on(self, level: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the used pixels of both frames on a level, (h, w) bool; None for all."""
        return None if self.masks is None else self.masks.levels[level]

    def valid0(self, level: int) -> np.ndarray | None:
        """Return the used pixels of frame 0 on a level, (h, w) bool; None for all."""
        return None if self.masks is None else self.masks.levels[level][0]

    def spline1(self, level: int) -> np.ndarray:
        """Return the spline coefficients of frame 1 at a level, as `spline_taps` orders them."""
        return self._spline1[level]()

    def release_spline1(self, level: int) -> None:
        """Free the spline coefficients of a level; the next `spline1` computes them again."""
        self._spline1[level] = self._spline(level)

    def set_frames1(self, frames1: list[np.ndarray]) -> None:
        """Replace frame 1 of every level, (h, w) float32 each, the finest first."""
        self.frames1 = frames1
        self._spline1 = [self._spline(level) for level in range(self.levels)]

    def reversed(self) -> "ImagePyramid":
        """Return the pyramid with both frames exchanged."""
        result = copy(self)
        result.frames0, result.frames1 = self.frames1, self.frames0
        result._spline1 = [result._spline(level) for level in range(self.levels)]
        result.masks = None if self.masks is None else self.masks.reversed()
        result.contrast = mean_step(result.frames0[0], result.valid0(0))
        return result

    def coarser(self, level: int) -> "ImagePyramid":
        """Return the pyramid of `level`, as its finest level, and all coarser levels.

        The new pyramid shares frames and splines with this pyramid.
        """
        if level == 0:
            return self
        result = copy(self)
        result.frames0, result.frames1 = self.frames0[level:], self.frames1[level:]
        result.cameras, result._spline1 = self.cameras[level:], self._spline1[level:]
        result.scales = [scale / self.scales[level] for scale in self.scales[level:]]
        result.levels, result.last = self.levels - level, max(0, self.last - level)
        result.shape = result.frames0[0].shape
        result.masks = None if self.masks is None else self.masks.coarser(level)
        result.contrast = mean_step(result.frames0[0], result.valid0(0))
        return result

    def _spline(self, level: int) -> Callable[[], np.ndarray]:
        return cache(partial(spline_taps, self.frames1[level]))


def level_count(height: int, width: int, factor: float, max_count: int | None = None) -> int:
    """Return the number of levels that `COARSEST_FRAME_SIDE` allows, at most `max_count`."""
    side = min(height, width)
    count = 1
    if side > COARSEST_FRAME_SIDE:
        count += int(math.log(COARSEST_FRAME_SIDE / side) / math.log(factor))
    return count if max_count is None else min(count, max_count)


def gaussian_pyramid(
    image: np.ndarray,  # (H, W) float32
    factor: float,
    levels: int,
) -> list[np.ndarray]:
    """Return `levels` images, the finest first, each `factor` times as densely sampled.

    The scale is exactly `factor` in both directions, however sizes are rounded: pixel x of a level
    lies at (x + ½)/factor − ½ on the next finer level. Before resampling, each level is smoothed by
    a Gaussian of 0.6·√(1/factor² − 1) px, so that all levels are equally sharp.

    References
    ----------
    Sánchez, Meinhardt-Llopis, Facciolo, "TV-L1 optical flow estimation", IPOL 2013, section 2.5,
    doi 10.5201/ipol.2013.26.
    """
    sigma = 0.6 * math.sqrt(1 / factor**2 - 1)
    pyramid = [image]
    for _ in range(levels - 1):
        smooth_image = smooth(pyramid[-1], sigma)
        pyramid.append(
            cv2.resize(smooth_image, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
        )
    return pyramid


def smooth(image: np.ndarray, sigma: float) -> np.ndarray:
    """Return the image convolved with a Gaussian of `sigma` px, with reflected borders."""
    if sigma == 0:
        return image
    return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)
