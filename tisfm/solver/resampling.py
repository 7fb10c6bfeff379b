"""Images between levels of a pyramid that are a whole number of pixels to one.

Pixel x of the coarser level lies at factor·(x + ½) − ½ on the finer one, exactly, whatever the
rounding of the levels' sizes.
"""

import cv2
import numpy as np

from tisfm.kernels.layout.lanes import aligned_empty


def enlarged(images: np.ndarray, factor: int, height: int, width: int) -> np.ndarray:
    """Return images of a coarser level, (n, h, w), at the pixels of a finer one, bilinearly.

    Returns
    -------
    (n, height, width) float32
    """
    n, rows, columns = images.shape
    size = (factor * columns, factor * rows)
    out = aligned_empty((n, height, width))
    for coarse, fine in zip(images, out, strict=True):
        if fine.shape == size[::-1]:
            cv2.resize(coarse, size, dst=fine, interpolation=cv2.INTER_LINEAR)
        else:
            larger = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
            fine[...] = _fitted(larger, height, width)
    return out


def reduced(images: np.ndarray, factor: int, height: int, width: int) -> np.ndarray:
    """Return images of a finer level, (n, H, W), as means over the pixels of a coarser one.

    Returns
    -------
    (n, height, width) float32
    """
    fitted = (_fitted(fine, factor * height, factor * width) for fine in images)
    size = (width, height)
    return np.stack([cv2.resize(fine, size, interpolation=cv2.INTER_AREA) for fine in fitted])


def _fitted(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return an image cut to a size, or with its last row and column repeated up to it."""
    below, right = max(0, height - image.shape[0]), max(0, width - image.shape[1])
    if below or right:
        image = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return image[:height, :width]
