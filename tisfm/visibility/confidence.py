"""Confidence in the image motion of a pixel."""

import cv2
import numpy as np

from tisfm import runtime

CONFIDENCE_WINDOW = 15  # px: about the distance over which regularisation spreads data
MIN_RELATIVE_GRADIENT = 1e-6  # share of the largest J11 + J22: below it, a pixel has no gradient
HALF_SHARE_FACTOR = 4.0  # multiple of the median squared residual that halves the confidence
# Smallest value for the median residual, px, and grey levels if constraints are not normalised. If
# most of the image is at rest, the median is smaller, but larger residuals are still only noise.
MIN_RESIDUAL, MIN_RESIDUAL_GREY = 0.05, 0.5


def confidence(
    # (7, h, w) float32: J11, J12, J22, squared residual, M11, M12, M22 (`data_precision`).
    # Modified. It belongs to the frame, or to a coarser level of its pyramid; confidence is then
    # interpolated.
    precision: np.ndarray,
    occlusion: np.ndarray,  # (H, W) bool: where a pixel is not visible in frame 1
    *,
    normalized: bool,  # whether the data constraints are distances in px
    freedom: int = 2,  # {2, 1}: degrees of freedom of a pixel's flow
) -> np.ndarray:
    """Return the confidence from the precision of the data and from their residuals.

    The share of the data in the two degrees of freedom of a pixel's flow is
    ½ tr[J M (I + J M)⁻¹], with J the precision of the data in a window around the pixel and M the
    covariance of the pixel's flow given its neighbours. The share is 0 without texture, at most ½
    if only one direction is seen (the aperture problem), and near 1 at a corner. If the motion is
    free along one line only, the share is tr[J M (I + J M)⁻¹].

    The share is divided by 1 + r/(4·r̃), with r the mean squared residual in the window and r̃ its
    median over the pixels with a gradient, but at least the square of `MIN_RESIDUAL`. Where the
    data constraints are violated, mostly at occlusions, texture alone does not make the motion
    reliable.

    Returns (H, W) float32 in [0, 1]; 0 for occluded pixels, and where the motion diverged to NaN.
    """
    runtime.start()  # before kernels are imported
    from tisfm.kernels.solve.data_precision import share_of_data

    # Pixels without a gradient have no residual, so they are left out of the median.
    gradient = precision[0] + precision[2]
    is_textured = gradient > MIN_RELATIVE_GRADIENT * gradient.max()
    window = (CONFIDENCE_WINDOW, CONFIDENCE_WINDOW)
    for k in range(4):
        cv2.boxFilter(precision[k], -1, window, dst=precision[k], normalize=k == 3)
    median_residual = median(precision[3][is_textured]) if is_textured.any() else 0.0
    # `max` in this order: if the motion diverged the median may be NaN, and max then drops it.
    half_share_residual = HALF_SHARE_FACTOR * max(
        (MIN_RESIDUAL if normalized else MIN_RESIDUAL_GREY) ** 2, median_residual
    )
    share = np.empty_like(precision[3])
    share_of_data(precision, share, half_share_residual=half_share_residual, freedom=freedom)
    if share.shape != occlusion.shape:
        share = cv2.resize(share, occlusion.shape[::-1], interpolation=cv2.INTER_LINEAR)
    np.nan_to_num(share, copy=False, nan=0)
    share[occlusion] = 0
    return np.clip(share, 0, 1, out=share)


def median(values: np.ndarray) -> float:
    """Return the median of values, (N,); faster than NumPy's, which also checks for NaN."""
    middle = len(values) // 2
    partition = np.partition(values, middle)
    upper_middle = float(partition[middle])
    return upper_middle if len(values) % 2 else (float(partition[:middle].max()) + upper_middle) / 2
