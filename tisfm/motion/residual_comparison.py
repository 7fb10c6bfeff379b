"""Which of two motions of a pixel the images bear out: by the residuals of the data term."""

import cv2
import numpy as np

from tisfm.motion.matched_windows import Windows
from tisfm.solver.data_term import Constancy

MOST_OFF = 5.0  # deviations of the noise: no residual counts for more


class ResidualComparison:
    """How far frame 1 is off along a flow, in deviations of the noise.

    Parameters
    ----------
    windows : Windows
    constancy : Constancy
        Its weights are those of brightness and of the gradient.
    """

    def __init__(self, windows: Windows, constancy: Constancy) -> None:
        weights = (constancy.brightness, constancy.gradient, constancy.gradient)
        self._weights = [weight / sum(weights) for weight in weights]
        self._noise = windows.noise
        self._frames0, self._frames1 = map(_with_slopes, (windows.levels0, windows.levels1))

    def better(
        self, flow: np.ndarray, other: np.ndarray, *, window: int, by: float = 0.0
    ) -> np.ndarray:
        """Return where frame 1 is off by less along a flow than along another, (h, w) bool.

        Parameters
        ----------
        flow, other : (h, w, 2) float32
            px/frame.
        window : int
            px: the side of the square that residuals are means over, weighted so that a pixel at a
            corner belongs to what it is a corner of.
        by : float
            Deviations of the noise.
        """
        mean, others = (
            cv2.GaussianBlur(self._off(of), (window, window), 0) for of in (flow, other)
        )
        return np.asarray(mean < others - by)

    def _off(self, flow: np.ndarray) -> np.ndarray:
        height, width = flow.shape[:2]
        x = flow[..., 0] + np.arange(width, dtype=np.float32)
        y = flow[..., 1] + np.arange(height, dtype=np.float32)[:, None]
        total = np.zeros((height, width), np.float32)
        for weight, frame0, frame1 in zip(self._weights, self._frames0, self._frames1, strict=True):
            moved = cv2.remap(frame1, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            total += weight * np.minimum(np.abs(moved - frame0) / self._noise, MOST_OFF)
        return total


def _with_slopes(levels: np.ndarray) -> list[np.ndarray]:
    """Return a frame, over √2 as the difference of two has that times its noise, and its slopes."""
    slope = np.array([[-0.5, 0, 0.5]], np.float32)
    across, down = (cv2.filter2D(levels, cv2.CV_32F, kernel) for kernel in (slope, slope.T))
    return [levels / np.float32(2**0.5), across, down]
