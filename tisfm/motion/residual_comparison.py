"""Comparison of two motions of a pixel by the residuals of the data term."""

import cv2
import numpy as np

from tisfm.motion.matched_windows import Windows
from tisfm.solver.data_term import Constancy

LARGEST_RESIDUAL = 5.0  # deviations of the noise, at which residuals are clipped; set by hand


class ResidualComparison:
    """Residuals of frame 1 along a flow, in standard deviations of the noise."""

    def __init__(
        self,
        windows: Windows,
        constancy: Constancy,  # its weights of brightness and of the gradient are used
    ) -> None:
        weights = (constancy.brightness, constancy.gradient, constancy.gradient)
        self._weights = [weight / sum(weights) for weight in weights]
        self._noise = windows.noise
        self._frames0, self._frames1 = map(_frame_and_slopes, (windows.grey0, windows.grey1))

    def is_better(
        self,
        # flow, other: (h, w, 2) float32, px/frame
        flow: np.ndarray,
        other: np.ndarray,
        *,
        # px: side of the square in which residuals are averaged with Gaussian weights, so that a
        # pixel at the corner of an object takes part in that object
        window: int,
        min_gain: float = 0.0,  # least difference, deviations of the noise
    ) -> np.ndarray:
        """Return where a flow has a smaller residual than another flow, (h, w) bool."""
        residual, other_residual = (
            cv2.GaussianBlur(self._residual(one), (window, window), 0) for one in (flow, other)
        )
        return np.asarray(residual < other_residual - min_gain)

    def _residual(self, flow: np.ndarray) -> np.ndarray:
        height, width = flow.shape[:2]
        x = flow[..., 0] + np.arange(width, dtype=np.float32)
        y = flow[..., 1] + np.arange(height, dtype=np.float32)[:, None]
        total = np.zeros((height, width), np.float32)
        for weight, frame0, frame1 in zip(self._weights, self._frames0, self._frames1, strict=True):
            warped = cv2.remap(frame1, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            total += weight * np.minimum(np.abs(warped - frame0) / self._noise, LARGEST_RESIDUAL)
        return total


def _frame_and_slopes(levels: np.ndarray) -> list[np.ndarray]:
    """Return a frame divided by √2, and its slopes.

    The difference of two frames has √2 times the noise of one.
    """
    slope = np.array([[-0.5, 0, 0.5]], np.float32)
    across, down = (cv2.filter2D(levels, cv2.CV_32F, kernel) for kernel in (slope, slope.T))
    return [levels / np.float32(2**0.5), across, down]
