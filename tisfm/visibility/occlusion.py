"""Occlusion: the pixels of frame 0 that are not visible in frame 1."""

from typing import TYPE_CHECKING

import cv2
import numpy as np

from tisfm import runtime
from tisfm.settings import Settings
from tisfm.solver.sampling import FAR_FLOW, enlarge, sample, shrink

if TYPE_CHECKING:
    from tisfm.solver.image_pyramid import ImagePyramid

MAX_DENSITY = 1.23  # pixels of frame 0 per pixel of frame 1 above which some of them are hidden
# px/frame from the mean flow of all pixels that move to one position, the pixel itself included;
# for two pixels, a relative motion of 0.14 px/frame. Pixels with the same motion belong to one
# surface that became smaller, so none of them is hidden.
MIN_FLOW_DIFFERENCE = 0.07
# px beyond the border that count as inside: flow of a static background has smaller errors
BORDER_MARGIN = 0.05
RESIDUAL_WINDOW = 3  # px: side of the window over which residuals are averaged
_FIVE_TAP = np.array([[1, -8, 0, 8, -1]], np.float32) / 12


def occlusion(
    # frame0, frame1: (h, w) float32, grey levels on the 8-bit scale, smoothed as the settings say.
    # They have the size of the flow, or the size of a coarser level of the pyramid: the residuals
    # are then computed on that level.
    frame0: np.ndarray,
    frame1: np.ndarray,
    # (2, H, W) float32: (u, v), px/frame. A pixel whose flow is not finite counts as leaving the
    # image.
    flow: np.ndarray,
    settings: Settings,  # for the weights of the data constraints
    *,
    factor: int = 1,  # number of flow pixels per frame pixel, along a side
    # ((h + 3)·w, 4) float32: `tisfm.solver.sampling.spline_taps` of frame 1, if already computed
    spline1: np.ndarray | None = None,
    # (H, W) bool: `leaves_image` of the flow, if already computed
    is_leaving: np.ndarray | None = None,
    # (H, W) float32: `flow_residual` of the flow or of nearly the same flow, if already computed
    residual: np.ndarray | None = None,
) -> np.ndarray:  # (H, W) bool
    """Find the pixels that leave the image or are hidden, by the uniqueness of the mapping.

    Each position of frame 1 shows one surface only. If the flow moves two surfaces to the same
    position, the surface with the larger data residual is hidden. This needs no backward flow; the
    usual check of forward against backward flow costs a second interpretation. With the usual
    thresholds that check has a lower F1 on scenes with exact truth; with looser thresholds it
    finds more occlusions on some sequences, at a lower precision (bench/results/tried.md).

    References
    ----------
    The idea is from Xu, Jia, Matsushita, "Motion detail preserving optical flow estimation",
    PAMI 34 (2012), 1744. They count the pixels that move to each position; here the residuals also
    decide which of them are hidden.
    """
    any_order = (
        runtime.runs_on_gpu()
    )  # first: it starts Taichi, which must precede import of kernels
    from tisfm.kernels.data.forward_splatting import hidden_pixels, splat
    from tisfm.kernels.layout.lanes import aligned_empty

    if is_leaving is None:
        is_leaving = leaves_image(flow)
    flow = _clip_flow(flow)
    if residual is None:
        residual = flow_residual(frame0, frame1, flow, settings, factor=factor, spline1=spline1)
    sums = aligned_empty((*residual.shape, 4))
    is_hidden = np.empty(residual.shape, np.int32)
    splat(flow, residual, sums, any_order=any_order)
    hidden_pixels(
        flow, residual, sums, is_hidden, density=MAX_DENSITY, flow_difference=MIN_FLOW_DIFFERENCE
    )
    return is_hidden.astype(bool) | is_leaving


def pyramid_occlusion(
    pyramid: "ImagePyramid",
    flow: np.ndarray,
    settings: Settings,
    *,
    is_leaving: np.ndarray | None = None,
    level: int = 0,
    residual: np.ndarray | None = None,
) -> np.ndarray:
    """Return the occlusion, (H, W) bool, for a flow of the finest level, (2, H, W).

    As `occlusion`, but pixels that a mask ignores in one of the frames are occluded too. The
    residuals are `residual`, or they are computed from the frames of `level`. A pyramid with a
    factor other than ½ uses level 0 instead, since its coarse pixels do not contain a whole number
    of finest pixels.
    """
    if pyramid.factor != 0.5:
        level = 0
    is_hidden = occlusion(
        pyramid.frames0[level],
        pyramid.frames1[level],
        flow,
        settings,
        factor=2**level,
        spline1=pyramid.spline1(level),
        is_leaving=is_leaving,
        residual=residual,
    )
    return is_hidden if pyramid.masks is None else is_hidden | pyramid.masks.ignored_pixels(flow)


def leaves_image(flow: np.ndarray) -> np.ndarray:
    """Return whether each pixel of a flow, (2, H, W), leaves the image; True for NaN."""
    height, width = flow.shape[1:]
    x = np.arange(width, dtype=np.float32)
    y = np.arange(height, dtype=np.float32)[:, None]
    is_inside = flow[0] >= -BORDER_MARGIN - x
    is_inside &= flow[0] <= width - 1 + BORDER_MARGIN - x
    is_inside &= flow[1] >= -BORDER_MARGIN - y
    is_inside &= flow[1] <= height - 1 + BORDER_MARGIN - y
    return np.logical_not(is_inside, out=is_inside)


def flow_residual(
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,
    settings: Settings,
    *,
    factor: int = 1,
    spline1: np.ndarray | None = None,
) -> np.ndarray:
    """Return the residual of brightness and gradient for a flow, grey levels: (H, W) float32.

    The arguments are as for `occlusion`. The residual is computed at the size of the frames.
    """
    flow = _clip_flow(flow)
    if factor == 1:
        return _residual(frame0, sample(frame1, flow, spline1), settings)
    coarse_flow = shrink(flow, factor, *frame0.shape) / np.float32(factor)
    residual = _residual(frame0, sample(frame1, coarse_flow, spline1), settings)
    return enlarge(residual[None], factor, *flow.shape[1:])[0]


def _clip_flow(flow: np.ndarray) -> np.ndarray:
    """Return a flow without NaN and with clipped values; both kinds of values leave any image.

    Kernels cannot do this: compiled with fast math, their comparisons with NaN may be true.
    """
    if flow.min() >= -FAR_FLOW and flow.max() <= FAR_FLOW:
        return flow
    flow = np.clip(flow, -FAR_FLOW, FAR_FLOW)
    flow[np.isnan(flow)] = FAR_FLOW
    return flow


def _residual(frame0: np.ndarray, warped1: np.ndarray, settings: Settings) -> np.ndarray:
    """Return the residual of brightness and gradient around every pixel, grey levels.

    It is not divided by the image's gradient as in the energy, which would find fewer occlusions.
    """
    change = cv2.subtract(warped1, frame0)
    residual = cv2.multiply(change, change, scale=settings.brightness)
    if settings.gradient > 0:
        slope = np.empty_like(change)
        for taps in (_FIVE_TAP, _FIVE_TAP.T):
            cv2.filter2D(change, -1, taps, dst=slope, borderType=cv2.BORDER_REFLECT_101)
            cv2.multiply(slope, slope, dst=slope)
            cv2.scaleAdd(slope, settings.gradient, residual, dst=residual)
    np.sqrt(residual, out=residual)
    window = (RESIDUAL_WINDOW, RESIDUAL_WINDOW)
    return cv2.blur(residual, window, dst=change, borderType=cv2.BORDER_REFLECT_101)
