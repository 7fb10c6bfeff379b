"""Where the image has edges, motion may have them: the image-driven factor of the smoothness."""

import cv2
import numpy as np

from tisfm.field import LaneData
from tisfm.kernels.images import image_to_lanes
from tisfm.kernels.lanes import LaneGrid


def mean_step(frame: np.ndarray) -> float:
    """Return the mean |ΔI| between neighbours of a frame, (H, W): its contrast."""
    height, width = frame.shape
    count = height * (width - 1) + (height - 1) * width
    total = cv2.norm(frame[:, 1:], frame[:, :-1], cv2.NORM_L1) if width > 1 else 0.0
    total += cv2.norm(frame[1:], frame[:-1], cv2.NORM_L1) if height > 1 else 0.0
    return total / max(count, 1)


def image_edges(frame: np.ndarray, strength: float) -> np.ndarray:
    """Return g = c/(1 + κ|ΔI|/m) of every edge, m the mean of |ΔI|, c such that the mean of g is 1.

    It depends on the contrast of an edge relative to those of the whole frame alone, and leaves
    the smoothness, on average, as strong as it is without.

    Parameters
    ----------
    frame : (H, W) float32
        Grey levels.
    strength : float
        κ; 0 for g = 1.

    Returns
    -------
    (2, H, W) float32
        Eastern and southern edges; 0 across the border.
    """
    height, width = frame.shape
    edges = np.empty((2, height, width), np.float32)
    np.subtract(frame[:, 1:], frame[:, :-1], out=edges[0, :, :-1])
    np.subtract(frame[1:], frame[:-1], out=edges[1, :-1])
    edges[0, :, -1] = edges[1, -1] = 0
    np.abs(edges, out=edges)
    # A uniform frame has no edges; what float32 tells apart is about 1e-5 grey levels.
    edges *= np.float32(strength / max(mean_step(frame), 1e-5))
    edges += 1
    np.reciprocal(edges, out=edges)
    edges[0, :, -1] = edges[1, -1] = 0
    count = height * (width - 1) + (height - 1) * width
    mean = sum(cv2.sumElems(side)[0] for side in edges) / max(count, 1)
    edges /= np.float32(max(mean, 1e-12))
    return edges


def image_edges_in_lanes(grid: LaneGrid, frame: np.ndarray, strength: float) -> LaneData:
    """Return `image_edges` as a lane array of 2 components."""
    out = grid.allocate(2)
    for component, edges in enumerate(image_edges(frame, strength)):
        image_to_lanes(grid, edges, out, component=component)
    return out
