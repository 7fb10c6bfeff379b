"""How far to trust the image motion of a pixel."""

import cv2
import numpy as np

from tisfm import runtime

CONFIDENCE_WINDOW = 15  # px: about as far as the regularisation carries data
ROUNDING = 1e-6  # of the largest J11 + J22: smoothing leaves less where an image is uniform
TOLERATED_RESIDUAL = 4.0  # times the median residual that halves the confidence
# px, and grey levels where constraints are not normalised: residuals that are no cause for doubt,
# though all of a background at rest may be smaller.
QUIET, QUIET_GREY = 0.05, 0.5


def confidence(
    precision: np.ndarray, occlusion: np.ndarray, *, normalized: bool, freedom: int = 2
) -> np.ndarray:
    """Combine what the data determine with how well they are met.

    The share of the data in the two degrees of freedom of a pixel's flow is
    ½ tr[J M (I + J M)⁻¹], with J the precision of the data in a window around it and M the
    covariance that its neighbours leave: 0 without texture, at most ½ where only one direction
    is seen (the aperture problem), near 1 at a corner. Where motion is free along one line only,
    it is tr[J M (I + J M)⁻¹]. It is divided by 1 + r/(4·r̃), r the mean
    squared residual in the window and r̃ its median over the pixels with a gradient, or what
    hardly matters if that is more: where the
    data constraints are not met, at occlusions above all, texture is no reason for trust.

    Parameters
    ----------
    precision : (7, h, w) float32
        J11, J12, J22, squared residual, M11, M12, M22 (`data_precision`). Modified.
        Of the frame, or of a coarser level of its pyramid: then confidence is interpolated.
    occlusion : (H, W) bool
        Where a pixel is not visible in frame 1.
    normalized : bool
        Whether the data constraints are distances in px.
    freedom : {2, 1}
        Degrees of freedom of a pixel's flow.

    Returns
    -------
    (H, W) float32
        In [0, 1]; 0 where occluded, and where the motion diverged so far that there is no number.
    """
    runtime.start()  # before kernels are imported
    from tisfm.kernels.solve.data_precision import share_of_data

    # Without a gradient there is no residual: uniform parts say nothing of what is usual.
    gradient = precision[0] + precision[2]
    textured = gradient > ROUNDING * gradient.max()
    window = (CONFIDENCE_WINDOW, CONFIDENCE_WINDOW)
    for k in range(4):
        cv2.boxFilter(precision[k], -1, window, dst=precision[k], normalize=k == 3)
    usual = median(precision[3][textured]) if textured.any() else 0.0
    # In this order: where motion diverged, the median may be no number.
    tolerated = TOLERATED_RESIDUAL * max((QUIET if normalized else QUIET_GREY) ** 2, usual)
    share = np.empty_like(precision[3])
    share_of_data(precision, share, tolerated=tolerated, freedom=freedom)
    if share.shape != occlusion.shape:
        share = cv2.resize(share, occlusion.shape[::-1], interpolation=cv2.INTER_LINEAR)
    np.nan_to_num(share, copy=False, nan=0)
    share[occlusion] = 0
    return np.clip(share, 0, 1, out=share)


def median(values: np.ndarray) -> float:
    """Return the median of values, (N,), several times as fast as NumPy, which looks for NaN."""
    middle = len(values) // 2
    parted = np.partition(values, middle)
    upper = float(parted[middle])
    return upper if len(values) % 2 else (float(parted[:middle].max()) + upper) / 2
