"""Sampling of images by cubic splines, and resampling between levels of a pyramid.

`enlarge` and `shrink` need an integer ratio of sampling densities. Pixel x of the coarser level
lies exactly at factor·(x + ½) − ½ on the finer level, however the levels' sizes are rounded.
"""

import math

import cv2
import numpy as np

from tisfm import runtime

FAR_FLOW = 1e7  # px/frame: a flow of this length leads outside any image
_POLE = math.sqrt(3) - 2  # of the filter that computes the coefficients of a cubic B-spline
_FILTER_RADIUS = 12  # px: weights farther out are below 1e-7, less than float32 resolves
# The filter (1, 4, 1)/6 computes pixels from coefficients; its inverse is the filter here.
_FILTER = math.sqrt(3) * _POLE ** np.abs(np.arange(-_FILTER_RADIUS, _FILTER_RADIUS + 1))


def spline_coefficients(
    image: np.ndarray,  # (H, W) float32; mirrored at the centres of its border pixels
) -> np.ndarray:  # (H, W) float32
    """Return the coefficients of the cubic B-spline through all pixels of an image.

    References
    ----------
    Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Processing
    Magazine 16 (1999) 22–38, doi 10.1109/79.799930.
    """
    return cv2.sepFilter2D(image, -1, _FILTER, _FILTER, borderType=cv2.BORDER_REFLECT_101)


def spline_taps(
    image: np.ndarray,  # (H, W) float32
) -> np.ndarray:
    """Return the coefficients of an image's spline in the layout of the kernels, rows of four.

    Returns ((H + 3)·W, 4) float32 in aligned memory. Row r·W + x holds the coefficients of columns
    x − 1 to x + 2 in image row r − 1. A sample between image rows y and y + 1 and columns x and
    x + 1 needs r = y to y + 3. Beyond the border, coefficients are mirrored at the centres of the
    border pixels.
    """
    return _taps_of(spline_coefficients(image))


def weight_taps(
    weight: np.ndarray,  # (H, W) float32
) -> tuple[np.ndarray, np.ndarray]:
    """Return weights smoothed by a B-spline, (H, W) float32, and `spline_taps` of this spline.

    The coefficients are the weights themselves. Samples then stay within the range of the weights;
    a spline through the weights would overshoot.
    """
    smoothing = np.array([1, 4, 1]) / 6
    border = cv2.BORDER_REFLECT_101
    return cv2.sepFilter2D(weight, -1, smoothing, smoothing, borderType=border), _taps_of(weight)


def _taps_of(coefficients: np.ndarray) -> np.ndarray:
    """Return coefficients, (H, W) float32, in the layout of `spline_taps`."""
    from tisfm.kernels.layout.lanes import aligned_empty

    height, width = coefficients.shape
    coefficients = cv2.copyMakeBorder(coefficients, 1, 2, 1, 2, borderType=cv2.BORDER_REFLECT_101)
    taps = aligned_empty(((height + 3) * width, 4))
    shifted_images = [coefficients[:, k : k + width] for k in range(4)]
    cv2.merge(shifted_images, taps.reshape(height + 3, width, 4))
    return taps


def sample(
    image: np.ndarray,  # (H, W) float32
    flow: np.ndarray,  # (2, H, W) float32: (u, v), px; finite
    # ((H + 3)·W, 4) float32: `spline_taps` of the image, if already computed
    taps: np.ndarray | None = None,
) -> np.ndarray:  # (H, W) float32
    """Return an image sampled at the ends of flow vectors by its cubic spline; borders repeat."""
    grid = runtime.lane_grid(*image.shape)  # starts Taichi, which must precede the imports
    from tisfm.kernels.data.warp import warp
    from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images
    from tisfm.kernels.layout.lanes import aligned_empty

    motion, mask, warped = (grid.allocate(n, zeros=False) for n in (2, 1, 1))
    for component, values in enumerate(flow):
        image_to_lanes(grid, values, motion, component=component)
    warp(grid, image, spline_taps(image) if taps is None else taps, motion, warped, mask)
    out = aligned_empty(image.shape)
    lanes_to_images(grid, warped, out[None])
    return out


def target_pixels(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns, (H, W), of the pixels nearest to the ends of a flow, (2, H, W).

    Where the flow leaves the image or is not finite, these are pixels of the border.
    """
    height, width = flow.shape[1:]
    flow = np.clip(np.nan_to_num(flow, nan=FAR_FLOW), -FAR_FLOW, FAR_FLOW)
    x = np.rint(flow[0] + np.arange(width)).clip(0, width - 1)
    y = np.rint(flow[1] + np.arange(height)[:, None]).clip(0, height - 1)
    return y.astype(np.intp), x.astype(np.intp)


def enlarge(images: np.ndarray, factor: int, height: int, width: int) -> np.ndarray:
    """Return images of a coarser level, (n, h, w), interpolated bilinearly to a finer level.

    Returns (n, height, width) float32.
    """
    from tisfm.kernels.layout.lanes import aligned_empty

    n, rows, columns = images.shape
    size = (factor * columns, factor * rows)
    out = aligned_empty((n, height, width))
    for coarse, fine in zip(images, out, strict=True):
        if fine.shape == size[::-1]:
            cv2.resize(coarse, size, dst=fine, interpolation=cv2.INTER_LINEAR)
        else:
            fine_image = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
            fine[...] = _crop_or_extend(fine_image, height, width)
    return out


def shrink(images: np.ndarray, factor: int, height: int, width: int) -> np.ndarray:
    """Return images of a finer level, (n, H, W), averaged over the pixels of a coarser level.

    Returns (n, height, width) float32.
    """
    frames = (_crop_or_extend(fine, factor * height, factor * width) for fine in images)
    size = (width, height)
    return np.stack([cv2.resize(fine, size, interpolation=cv2.INTER_AREA) for fine in frames])


def _crop_or_extend(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return an image cropped to a size, or extended by repeating its last row and column."""
    below, right = max(0, height - image.shape[0]), max(0, width - image.shape[1])
    if below or right:
        image = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return image[:height, :width]
