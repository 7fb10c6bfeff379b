"""Whether two frames show the same things, and whether a known pose explains how they move."""

import cv2
import numpy as np

from tisfm.outcome import Status
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.visibility.confidence import CONFIDENCE_WINDOW

# Median correlation of frames that show the same: 0.97 and more on benchmarks, 0.65 under noise of
# 40 grey levels. Of unrelated scenes and of noise it is below 0.4.
CORRELATED = 0.5
JUDGED = 2**12  # pixels, at least, of the level that a flow field is judged on
# Distances of a flow from a pose, over those from the motion that fits best: at most 5.7 where
# poses are measured (7-Scenes), 17 and more where such a pose is inverted or t is reversed.
OFF = 8.0
LEAST_DISTANCE = 0.02  # px: distances from the best that are no smaller in real frames
FLATTEST = 1e-12  # of two variances, in units of the frame's: none where it is flat


def unrelated(
    frame0: np.ndarray, frame1: np.ndarray, flow: np.ndarray, trust: np.ndarray
) -> Status | None:
    """Return the status of frames that a flow does not make alike, None if it does.

    That is judged by their correlation in windows, at the median of what is trusted.

    Parameters
    ----------
    frame0, frame1 : (H, W) float32
        Grey levels.
    flow : (H, W, 2) float32
        px/frame.
    trust : (H, W) float32
        Its confidence; not all 0.
    """
    alike = correlation(frame0, frame1, flow)
    order = np.argsort(alike, axis=None)
    total = np.cumsum(trust.ravel()[order], dtype=np.float64)
    median = float(alike.ravel()[order[np.searchsorted(total, total[-1] / 2)]])
    if median >= CORRELATED:
        return None
    return Status(
        "unrelated",
        f"the frames have little in common wherever their parts are moved to (correlation "
        f"{median:.2f}): check that they are of one scene, take them closer in time, or with less "
        "noise",
    )


def correlation(frame0: np.ndarray, frame1: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return the correlation of frame 0 with where a flow leads, in a window around each pixel.

    Parameters
    ----------
    frame0, frame1 : (H, W) float32
        Grey levels, not all the same in frame 0.
    flow : (H, W, 2) float32
        px/frame.

    Returns
    -------
    (H, W) float32
        In [-1, 1]; 0 where both are flat.
    """
    # Brightness may be on any scale, and squares lose digits far from 0.
    mean, unit = (np.float32(value(dtype=float)) for value in (frame0.mean, frame0.std))
    frame0, frame1 = (frame0 - mean) / unit, (frame1 - mean) / unit
    moved = _moved(frame1, flow)
    mean0, mean1 = _mean(frame0), _mean(moved)
    product = _variance(frame0, mean0) * _variance(moved, mean1)
    return (_mean(frame0 * moved) - mean0 * mean1) / np.sqrt(np.maximum(product, FLATTEST))


def unrelated_field(pyramid: ImagePyramid, flow: np.ndarray, trust: np.ndarray) -> Status | None:
    """Return the same of a flow field of the finest level, judged on a coarser one.

    Motion that is free at every pixel makes fine detail alike in any two frames.

    Parameters
    ----------
    pyramid : ImagePyramid
    flow : (2, H, W) float32
        px/frame.
    trust : (H, W) float32
        Its confidence.
    """
    level = max((k for k, frame in enumerate(pyramid.frames0) if frame.size >= JUDGED), default=0)
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    size, area = frame0.shape[::-1], cv2.INTER_AREA
    trust = cv2.resize(trust, size, interpolation=area)
    if not trust.any():
        return None
    coarse = cv2.merge([cv2.resize(part, size, interpolation=area) for part in flow])
    return unrelated(frame0, frame1, coarse * np.float32(pyramid.scales[level]), trust)


def mismatch(off: float, best: float, *, inverse: float | None = None) -> Status | None:
    """Return the status of a known pose that does not explain a flow, None if it does.

    Parameters
    ----------
    off : float
        How far the flow is from where the pose can take points, px of the finest level.
    best : float
        The same for the motion that fits best.
    inverse : float, optional
        The same for the inverse of the pose; not for a rotation alone.
    """
    tolerated = OFF * max(best, LEAST_DISTANCE)
    if off <= tolerated:
        return None
    if inverse is not None and inverse <= tolerated:
        advice = "its inverse explains them, so give np.linalg.inv(pose)"
    else:
        advice = (
            "check that it takes points from frame 0's camera to frame 1's, not back, that the "
            "axes are right, down and forward, that it is of these two frames, and the focal length"
        )
    return Status(
        "pose_mismatch",
        f"the pose given does not explain the images: they move to {off:.2g} px beside where it "
        f"can take points, the motion that fits best to {best:.2g} px; {advice}",
    )


def _moved(image: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return an image sampled where a flow, (H, W, 2), leads, bilinearly; beyond, it repeats.

    OpenCV's `remap` takes no image with a side of 32,767 px or more.
    """
    height, width = image.shape
    flow = np.nan_to_num(flow)  # where it diverged
    x = np.clip(flow[..., 0] + np.arange(width, dtype=np.float32), 0, width - 1)
    y = np.clip(flow[..., 1] + np.arange(height, dtype=np.float32)[:, None], 0, height - 1)
    left = np.minimum(x.astype(np.intp), width - 2)
    top = np.minimum(y.astype(np.intp), height - 2)
    across, down = x - left.astype(np.float32), y - top.astype(np.float32)
    site = top * width + left
    values = image.ravel()
    above = values[site] + across * (values[site + 1] - values[site])
    site += width
    below = values[site] + across * (values[site + 1] - values[site])
    moved: np.ndarray = above + down * (below - above)
    return moved


def _mean(image: np.ndarray) -> np.ndarray:
    return cv2.blur(image, (CONFIDENCE_WINDOW, CONFIDENCE_WINDOW))


def _variance(image: np.ndarray, mean: np.ndarray) -> np.ndarray:
    return np.maximum(_mean(image * image) - mean * mean, 0)
