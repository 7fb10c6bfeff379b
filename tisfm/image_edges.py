"""Where the image has edges, motion may have them: the image-driven factor of the smoothness."""

import numpy as np

from tisfm.field import LaneData
from tisfm.kernels.images import image_to_lanes
from tisfm.kernels.lanes import LaneGrid


def mean_step(frame: np.ndarray) -> float:
    """Return the mean |ΔI| between neighbours of a frame, (H, W): its contrast."""
    steps = [np.abs(np.diff(frame, axis=axis)) for axis in (0, 1)]
    count = max(sum(step.size for step in steps), 1)
    return sum(float(step.sum(dtype=np.float64)) for step in steps) / count


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
    steps = np.zeros((2, height, width), np.float32)
    steps[0, :, :-1] = np.abs(np.diff(frame, axis=1))
    steps[1, :-1] = np.abs(np.diff(frame, axis=0))
    inside = np.ones(steps.shape, bool)
    inside[0, :, -1] = inside[1, -1] = False
    count = max(int(inside.sum()), 1)
    # A uniform frame has no edges; what float32 tells apart is about 1e-5 grey levels.
    edges = np.float32(1) / (1 + np.float32(strength / max(mean_step(frame), 1e-5)) * steps)
    edges *= inside
    edges /= np.float32(max(float(edges.sum(dtype=np.float64)) / count, 1e-12))
    return edges


def image_edges_in_lanes(grid: LaneGrid, frame: np.ndarray, strength: float) -> LaneData:
    """Return `image_edges` as a lane array of 2 components."""
    out = grid.allocate(2)
    for component, edges in enumerate(image_edges(frame, strength)):
        image_to_lanes(grid, edges, out, component=component)
    return out
