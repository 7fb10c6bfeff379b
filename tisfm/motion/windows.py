"""What the window around a pixel shows."""

import cv2
import numpy as np


def window_variance(image: np.ndarray, size: int, mean: np.ndarray | None = None) -> np.ndarray:
    """Return the variance of the square window around every pixel.

    Squares lose digits far from 0, so the mean of the whole image is subtracted first, unless
    `mean` is given.

    Parameters
    ----------
    image : (H, W) float32
    size : int
        Side of the window, px, odd.
    mean : (H, W) float32, optional
        Mean of every window, of an image whose own mean is about 0.

    Returns
    -------
    (H, W) float32
        0 at least; not finite where squares are too large for float32.
    """
    window = (size, size)
    with np.errstate(over="ignore", invalid="ignore"):  # of frames that are far too bright
        if mean is None:
            image = image - image.mean()
            mean = cv2.blur(image, window)
        return np.maximum(cv2.blur(image * image, window) - mean * mean, 0)
