"""Variance, texture and correlation of the window around each pixel."""

import cv2
import numpy as np

from tisfm.visibility.confidence import CONFIDENCE_WINDOW

# product of two window variances, in units of the frame's variance
MIN_VARIANCE_PRODUCT = 1e-12


def window_variance(
    image: np.ndarray,  # (H, W) float32
    size: int,  # side of the window, px, odd
    # (H, W) float32: mean of every window, for an image whose mean is about 0
    mean: np.ndarray | None = None,
) -> np.ndarray:  # (H, W) float32: at least 0; not finite where squares are too large for float32
    """Return the variance of the square window around every pixel.

    Squares of values far from 0 lose digits, so the mean of the whole image is subtracted first,
    unless `mean` is given.
    """
    window = (size, size)
    with np.errstate(over="ignore", invalid="ignore"):  # frames may be far too bright
        if mean is None:
            image = image - image.mean()
            mean = cv2.blur(image, window)
        return np.maximum(cv2.blur(image * image, window) - mean * mean, 0)


def correlation(
    # frame0, frame1: (H, W) float32, grey levels; frame 0 is not uniform
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,  # (H, W, 2) float32: px/frame
) -> np.ndarray:  # (H, W) float32: in [-1, 1]; 0 where both frames are flat
    """Return the correlation of both frames along a flow, in a window around each pixel."""
    # Brightness may be on any scale, and squares of values far from 0 lose digits.
    mean, unit = (np.float32(statistic(dtype=float)) for statistic in (frame0.mean, frame0.std))
    frame0, frame1 = (frame0 - mean) / unit, (frame1 - mean) / unit
    warped1 = warp_image(frame1, flow)
    mean0, mean1 = mean_in_windows(frame0), mean_in_windows(warped1)
    product = variance_in_windows(frame0, mean0) * variance_in_windows(warped1, mean1)
    return (mean_in_windows(frame0 * warped1) - mean0 * mean1) / np.sqrt(
        np.maximum(product, MIN_VARIANCE_PRODUCT)
    )


def texture(frame: np.ndarray) -> np.ndarray:
    """Return the variance v of the window around each pixel as v / (v + median), in [0, 1)."""
    frame = frame - frame.mean()
    variance = variance_in_windows(frame, mean_in_windows(frame))
    median_variance = np.float32(np.median(variance))
    return variance / np.maximum(variance + median_variance, np.finfo(np.float32).tiny)


def warp_image(image: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return an image sampled bilinearly along a flow, (H, W, 2); outside, border pixels repeat.

    OpenCV's `remap` cannot be used: it rejects images with a side of 32,767 px or more.
    """
    height, width = image.shape
    flow = np.nan_to_num(flow)  # flow may diverge
    x = np.clip(flow[..., 0] + np.arange(width, dtype=np.float32), 0, width - 1)
    y = np.clip(flow[..., 1] + np.arange(height, dtype=np.float32)[:, None], 0, height - 1)
    left = np.minimum(x.astype(np.intp), width - 2)
    top = np.minimum(y.astype(np.intp), height - 2)
    fraction_x, fraction_y = x - left.astype(np.float32), y - top.astype(np.float32)
    index = top * width + left
    values = image.ravel()
    above = values[index] + fraction_x * (values[index + 1] - values[index])
    index += width
    below = values[index] + fraction_x * (values[index + 1] - values[index])
    values_at_flow: np.ndarray = above + fraction_y * (below - above)
    return values_at_flow


def mean_in_windows(image: np.ndarray) -> np.ndarray:
    """Return the mean of the square window around every pixel, (H, W) float32."""
    return cv2.blur(image, (CONFIDENCE_WINDOW, CONFIDENCE_WINDOW))


def variance_in_windows(image: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return the variance of the square window around every pixel, given its mean."""
    return window_variance(image, CONFIDENCE_WINDOW, mean)
