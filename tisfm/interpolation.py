"""Frames as cubic splines: what their values between pixels are read from."""

import math

import cv2
import numpy as np

_POLE = math.sqrt(3) - 2
_REACH = 14  # px: what lies farther has a weight below 1e-8
# The inverse of the filter (1, 4, 1)/6, by which coefficients give values at pixels.
_INVERSE = math.sqrt(3) * _POLE ** np.abs(np.arange(-_REACH, _REACH + 1))


def spline_coefficients(image: np.ndarray) -> np.ndarray:
    """Return the coefficients of the cubic B-spline through all pixels of an image.

    Parameters
    ----------
    image : (H, W) float32
        Mirrored at the centres of its border pixels.

    Returns
    -------
    (H, W) float32

    References
    ----------
    Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Processing
    Magazine 16 (1999) 22–38, doi 10.1109/79.799930.
    """
    return cv2.sepFilter2D(image, -1, _INVERSE, _INVERSE, borderType=cv2.BORDER_REFLECT_101)
