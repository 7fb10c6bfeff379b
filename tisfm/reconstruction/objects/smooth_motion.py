"""Smooth motions of regions, fitted to the image motion to the next and the previous frame."""

from typing import Literal

import numpy as np

from tisfm.reconstruction.frames.image_motion import ImageMotion, pixel_grid, vector_lengths

# Values without a stated source were set by hand.

# Smallest number of pixels for the fit of a smooth motion.
MIN_PIXELS = 30
# Smallest number of pixels for the fit of a quadratic motion.
MIN_PIXELS_QUADRATIC = 400
# px: pixels that differ by more from the expected velocity count little in the first round.
START_TOLERANCE = 1.0
# px: smallest standard deviation from a smooth motion.
MIN_DEVIATION = 0.2

Terms = Literal[1, 3, 6]


class SmoothMotions:
    """The image motion of a frame to the next and the previous frame."""

    def __init__(self, motion: ImageMotion, frame: int) -> None:
        self._flows = [
            (chain.positions - pixel_grid(chain.valid.shape), chain.valid)
            for chain in motion.chained_flows(frame, 1)
        ]
        self._has_next = frame + 1 < len(motion)
        # (H, W) bool: pixels that the next or the previous frame shows
        self.valid = np.any([valid for _, valid in self._flows], axis=0)
        # (H, W, 2) float32: to the next frame; for the last frame, the negative of the flow to the
        # previous frame
        self.flow = self._flows[0][0] if self._has_next else -self._flows[0][0]

    def residuals_from(
        self,
        mask: np.ndarray,  # (H, W) bool
        # (2,) array: velocity of most of the mask, px/frame, if known
        velocity: np.ndarray | None = None,
        *,
        # {1, 3, 6}: largest model: 1 is one velocity, 3 an affine, 6 a quadratic motion
        terms: Terms = 6,
    ) -> tuple[np.ndarray, float]:
        """Return each pixel's distance from the smooth motion of a mask, (H, W) px; 0 if unknown.

        Also return the standard deviation of the mask's own motion from its smooth motion, px.
        """
        total, count = np.zeros(mask.shape, np.float32), np.zeros(mask.shape, np.float32)
        deviations = []
        for index, (flow, valid) in enumerate(self._flows):
            pixels = mask & valid
            if pixels.sum() < MIN_PIXELS:
                continue
            sign = 1 if self._has_next and index == 0 else -1
            expected = None if velocity is None else sign * velocity
            residual = vector_lengths(flow - smooth_motion(flow, pixels, expected, terms))
            deviations.append(1.48 * float(np.median(residual[pixels])))
            total += np.where(valid, residual, 0)
            count += valid
        deviation = max([MIN_DEVIATION, *deviations])
        return total / np.maximum(count, 1), deviation


def smooth_motion(
    flow: np.ndarray,  # (H, W, 2) float32
    mask: np.ndarray,  # (H, W) bool
    # (2,) array: expected velocity, px/frame: pixels near it count most in the first round
    expected: np.ndarray | None = None,
    # {1, 3, 6}: 1 is one velocity, 3 an affine, 6 a quadratic motion. With few pixels, the motion
    # is affine at most.
    terms: Terms = 6,
) -> np.ndarray:
    """Return the smooth motion, (H, W, 2) float32, that fits a flow within a mask, robustly."""
    rows, columns = np.nonzero(mask)
    center = np.array([np.median(columns), np.median(rows)])
    size = max(1.0, float(max(np.ptp(columns), np.ptp(rows))) / 2)
    x, y = np.moveaxis((pixel_grid(flow.shape) - center) / size, -1, 0).clip(-2, 2)
    monomials = [np.ones_like(x), x, y, x * x, x * y, y * y]
    basis = np.stack(monomials[: terms if len(rows) >= MIN_PIXELS_QUADRATIC else min(terms, 3)], -1)
    stride = max(1, len(rows) // 4000)
    samples, flow_samples = basis[mask][::stride], flow[mask][::stride].astype(np.float64)
    weight = np.ones(len(flow_samples))
    if expected is not None:
        weight = (
            1 / (1 + (np.linalg.norm(flow_samples - expected, axis=1) / START_TOLERANCE) ** 2) ** 2
        )
    for _ in range(5):
        weighted = samples * weight[:, None]
        gram = weighted.T @ samples + 1e-6 * len(flow_samples) * np.eye(samples.shape[1])
        coefficients = np.linalg.solve(gram, weighted.T @ flow_samples)
        residual = np.linalg.norm(samples @ coefficients - flow_samples, axis=1)
        weight = 1 / (1 + (residual / max(1.48 * np.median(residual), 0.05)) ** 2)
    return np.float32(basis @ coefficients)
