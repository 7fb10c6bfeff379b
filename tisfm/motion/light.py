"""Changes of light between the frames of a pair: exposure, lamps, and a vignette.

A flow field compares frame 1 with frame 0 at corresponding pixels. If large regions became brighter
or darker, frame 1 is brought to the light of frame 0 before motion and depth are estimated.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.motion.camera_settings import LIGHT
from tisfm.motion.window_statistics import warp_image
from tisfm.status import Status
from tisfm.visibility.confidence import median


@dataclass(frozen=True, kw_only=True, eq=False)
class LightChange:
    """A smooth change of light, I₁ = gain · I₀ + offset, in coordinates of frame 1."""

    gain: np.ndarray  # (h, w) float32
    offset: float  # grey levels
    typical_change: float  # grey levels: median over regions of |I₁ - I₀|
    largest_change: float  # the same, of nearly the largest region

    @property
    def is_large(self) -> bool:
        """Whether the change may have disturbed the flow field that shows it."""
        return (
            self.typical_change > LIGHT.min_typical_change_of_flow
            or self.largest_change > LIGHT.min_large_change_of_flow
        )

    def remains(self, rest: "LightChange") -> bool:
        """Return whether most of a large change is left in the frames that it was undone in."""
        return any(
            before > smallest and after > LIGHT.max_rest * before
            for before, after, smallest in (
                (self.typical_change, rest.typical_change, LIGHT.min_typical_change_of_flow),
                (self.largest_change, rest.largest_change, LIGHT.min_large_change_of_flow),
            )
        )

    def undo(self, frame1: np.ndarray) -> np.ndarray:
        """Return frame 1, (H, W) float32 of any level, in the light of frame 0."""
        height, width = frame1.shape
        gain = cv2.resize(self.gain, (width, height), interpolation=cv2.INTER_LINEAR)
        return (frame1 - np.float32(self.offset)) / gain

    def warp(self, homography: np.ndarray, shape: tuple[int, ...]) -> "LightChange":
        """Return the change in other coordinates, which a homography of pixels leads to."""
        size = shape[::-1]
        gain = cv2.warpPerspective(
            cv2.resize(self.gain, size, interpolation=cv2.INTER_LINEAR),
            homography,
            size,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return replace(self, gain=gain)


def find_light_change(
    # frame0, frame1: (h, w) float32, grey levels
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,  # (h, w, 2) float32: px/frame
    trust: np.ndarray,  # (h, w) float32: confidence of the flow
) -> LightChange | None:
    """Return the change of light between two frames, None if it is not significant."""
    warped1 = warp_image(frame1, flow)
    used = (trust > LIGHT.min_trust).astype(np.float32)
    if used.mean() < LIGHT.min_used_share:
        return None
    sigma = LIGHT.region * max(frame0.shape)
    total = _region_mean(used, sigma)
    change = np.abs(_region_mean(used * (warped1 - frame0), sigma))
    is_known = total > LIGHT.min_region_share
    if not is_known.any():
        return None
    change = change[is_known] / total[is_known]
    typical, largest = (
        float(np.percentile(change, share)) for share in (50, LIGHT.large_percentile)
    )
    if typical < LIGHT.min_typical_change and largest < LIGHT.min_large_change:
        return None
    gain, offset = _global_change(frame0[used > 0], warped1[used > 0])
    changed0 = gain * frame0 + np.float32(offset)
    difference = warped1 - changed0
    scale = max(1.4826 * median(np.abs(difference[used > 0])), LIGHT.min_noise)
    smooth_difference = _region_mean(used * difference, sigma) / np.maximum(total, 1e-3)
    weight = used / (1 + ((difference - smooth_difference) / np.float32(3 * scale)) ** 2) ** 2
    # Squares of large grey levels exceed float32.
    unit = np.float32(max(float(np.abs(frame0).max()), 1.0))
    brightness, difference = np.float32(gain) * (frame0 / unit), difference / unit
    square = _region_mean(weight * brightness**2, sigma)
    product = _region_mean(weight * brightness * difference, sigma)
    prior = np.float32(LIGHT.prior_weight) * np.float32((brightness**2).mean())
    local_gain = 1 + product / (square + prior)
    local_gain = np.clip(local_gain, 1 / LIGHT.max_gain, LIGHT.max_gain)
    smooth_flow = cv2.GaussianBlur(flow, (0, 0), sigma / 2)
    return LightChange(
        gain=np.float32(gain) * warp_image(local_gain, -smooth_flow),
        offset=offset,
        typical_change=typical,
        largest_change=largest,
    )


def with_light_note(status: Status, light: tuple[LightChange, ...]) -> Status:
    """Return a status whose message says that a large change of light was undone."""
    if not any(change.is_large for change in light):
        return status
    largest_change = max(change.largest_change for change in light)
    return Status(
        status,
        f"{status.message}. The light changed by up to {largest_change:.0f} grey levels; frame 1 "
        "was brought to the light of frame 0",
    )


def _region_mean(image: np.ndarray, sigma: float) -> np.ndarray:
    """Return the mean of a region around each pixel, (h, w) float32."""
    return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)


def _global_change(grey0: np.ndarray, grey1: np.ndarray) -> tuple[float, float]:
    """Return gain and offset of a robust linear fit of grey levels, (N,)."""
    stride = max(1, len(grey0) // LIGHT.samples)
    x, y = (grey[::stride].astype(np.float64) for grey in (grey0, grey1))
    gain, offset = 1.0, float(np.median(y - x))
    for _ in range(LIGHT.iterations):
        residual = y - gain * x - offset
        scale = max(1.4826 * float(np.median(np.abs(residual))), LIGHT.min_noise)
        weight = 1 / (1 + (residual / (2 * scale)) ** 2) ** 2
        mean_x, mean_y = (weight @ values / weight.sum() for values in (x, y))
        variance = weight @ (x - mean_x) ** 2
        gain = float(weight @ ((x - mean_x) * (y - mean_y)) / max(variance, 1e-9))
        gain = float(np.clip(gain, 1 / LIGHT.max_gain, LIGHT.max_gain))
        offset = float(mean_y - gain * mean_x)
    return gain, offset
