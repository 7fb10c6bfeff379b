"""Which pixels of frame 0 are not visible in frame 1."""

from typing import TYPE_CHECKING

import cv2
import numpy as np

from tisfm import runtime
from tisfm.settings import Settings
from tisfm.solver.sampling import FAR, enlarged, reduced, sample

if TYPE_CHECKING:
    from tisfm.solver.image_pyramid import ImagePyramid

DENSITY = 1.23  # pixels of frame 0 per pixel of frame 1: more cannot all be seen there
# px/frame from the mean of all that go to a place, the pixel itself included: two pixels that move
# by 0.14 px/frame relative to each other. What moves alike is one surface, seen at a smaller scale.
APART = 0.07
MARGIN = 0.05  # px beyond the border: a background at rest drifts by less, and does not leave
RESIDUAL_WINDOW = 3  # px: residuals are means over it
_FIVE_TAP = np.array([[1, -8, 0, 8, -1]], np.float32) / 12


def occlusion(
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,
    settings: Settings,
    *,
    factor: int = 1,
    taps1: np.ndarray | None = None,
    leaves: np.ndarray | None = None,
    residual: np.ndarray | None = None,
) -> np.ndarray:
    """Find the pixels that leave the image or are hidden, by the uniqueness of the mapping.

    Only one surface is seen at a place of frame 1. Where the flow takes two of them there, the
    one whose data constraints are met worse is hidden. No flow backward in time is needed: the
    usual check of forward against backward flow costs another interpretation. At its usual
    thresholds its F1 is lower on scenes with exact truth; with looser ones it finds more on some
    sequences, at less precision (bench/results/tried.md).

    Parameters
    ----------
    frame0, frame1 : (h, w) float32
        Grey levels on the 8-bit scale, smoothed as the settings say; of the flow's size, or of a
        coarser level of the pyramid, by which constraints are then judged.
    flow : (2, H, W) float32
        (u, v), px/frame. Where it is not finite, the pixel counts as one that leaves the image.
    settings : Settings
        For the weights of the data constraints.
    factor : int
        Pixels of the flow to one of the frames, along a side.
    taps1 : ((h + 3)·w, 4) float32, optional
        `tisfm.solver.sampling.spline_taps` of frame 1, if they are at hand.
    leaves : (H, W) bool, optional
        `leaves_image` of the flow, if it is at hand.
    residual : (H, W) float32, optional
        `residual_of` the flow, or of one that is nearly the same, if it is at hand.

    Returns
    -------
    (H, W) bool

    References
    ----------
    The idea is that of Xu, Jia, Matsushita, "Motion detail preserving optical flow estimation",
    PAMI 34 (2012), 1744, who count how often a place is taken; who loses it is decided here.
    """
    any_order = runtime.on_gpu()  # before kernels are imported: it starts Taichi
    from tisfm.kernels.data.forward_splatting import defeated, splat
    from tisfm.kernels.layout.lanes import aligned_empty

    if leaves is None:
        leaves = leaves_image(flow)
    flow = _finite(flow)
    if residual is None:
        residual = residual_of(frame0, frame1, flow, settings, factor=factor, taps1=taps1)
    sums = aligned_empty((*residual.shape, 4))
    hidden = np.empty(residual.shape, np.int32)
    splat(flow, residual, sums, any_order=any_order)
    defeated(flow, residual, sums, hidden, density=DENSITY, apart=APART)
    return hidden.astype(bool) | leaves


def occlusion_in(
    pyramid: "ImagePyramid",
    flow: np.ndarray,
    settings: Settings,
    *,
    leaves: np.ndarray | None = None,
    level: int = 0,
    residual: np.ndarray | None = None,
) -> np.ndarray:
    """Find which pixels a flow of the finest level, (2, H, W), hides: (H, W) bool.

    As `occlusion` does, and with those that do not count in one of the frames; the frames of
    `level` tell how well the flow meets them, where its pixels are whole numbers of others, or
    `residual` does.
    """
    if pyramid.factor != 0.5:
        level = 0
    hidden = occlusion(
        pyramid.frames0[level],
        pyramid.frames1[level],
        flow,
        settings,
        factor=2**level,
        taps1=pyramid.taps1(level),
        leaves=leaves,
        residual=residual,
    )
    return hidden if pyramid.counted is None else hidden | pyramid.counted.missing(flow)


def leaves_image(flow: np.ndarray) -> np.ndarray:
    """Return where a flow, (2, H, W), ends outside the image; (H, W) bool, True for NaN."""
    height, width = flow.shape[1:]
    x = np.arange(width, dtype=np.float32)
    y = np.arange(height, dtype=np.float32)[:, None]
    stays = flow[0] >= -MARGIN - x
    stays &= flow[0] <= width - 1 + MARGIN - x
    stays &= flow[1] >= -MARGIN - y
    stays &= flow[1] <= height - 1 + MARGIN - y
    return np.logical_not(stays, out=stays)


def residual_of(
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,
    settings: Settings,
    *,
    factor: int = 1,
    taps1: np.ndarray | None = None,
) -> np.ndarray:
    """Return how badly a flow keeps brightness and its gradient, grey levels: (H, W) float32.

    The arguments are those of `occlusion`; the frames' pixels judge.
    """
    flow = _finite(flow)
    if factor == 1:
        return _residual(frame0, sample(frame1, flow, taps1), settings)
    coarse = reduced(flow, factor, *frame0.shape) / np.float32(factor)
    residual = _residual(frame0, sample(frame1, coarse, taps1), settings)
    return enlarged(residual[None], factor, *flow.shape[1:])[0]


def _finite(flow: np.ndarray) -> np.ndarray:
    """Return a flow with what is no number, or too large a one, outside of any image.

    That is not left to kernels: compiled for speed, they may take any comparison with NaN for true.
    """
    if flow.min() >= -FAR and flow.max() <= FAR:
        return flow
    flow = np.clip(flow, -FAR, FAR)
    flow[np.isnan(flow)] = FAR
    return flow


def _residual(frame0: np.ndarray, warped: np.ndarray, settings: Settings) -> np.ndarray:
    """Return how badly brightness and its gradient are kept around every pixel, in grey levels.

    Not normalised by the image's gradient, unlike in the energy: that finds fewer occlusions.
    """
    change = cv2.subtract(warped, frame0)
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
