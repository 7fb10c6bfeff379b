"""Frames as cubic splines: what their values between pixels are read from."""

import math

import cv2
import numpy as np

from tisfm import runtime

_POLE = math.sqrt(3) - 2
_REACH = 12  # px: what lies farther has a weight below 1e-7, less than float32 resolves
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


def sample(image: np.ndarray, flow: np.ndarray, spline: np.ndarray | None = None) -> np.ndarray:
    """Return an image sampled where a flow leads, by its cubic spline; beyond, it repeats.

    Parameters
    ----------
    image : (H, W) float32
    flow : (2, H, W) float32
        (u, v), px; finite.
    spline : (H, W) float32, optional
        Its `spline_coefficients`, if they are at hand.

    Returns
    -------
    (H, W) float32
    """
    grid = runtime.lane_grid(*image.shape)  # before kernels are imported: it starts Taichi
    from tisfm.kernels.images import image_to_lanes
    from tisfm.kernels.warp import warp

    motion, inside, out = grid.allocate(2), grid.allocate(1), np.empty_like(image)
    for component, values in enumerate(flow):
        image_to_lanes(grid, values, motion, component=component)
    spline = spline_coefficients(image) if spline is None else spline
    warp(grid, image, spline, motion, out, inside)
    return out
