"""Alignment of depth edges with image edges, for depth that was rendered from keyframes.

Rendered depth has ragged edges: each keyframe puts the edge of a surface elsewhere.
"""

import cv2
import numpy as np

from tisfm.kernels.rigid.surface_edges import RADIUS, by_look

# Values without a stated source were set by hand.

# Neighbours whose inverse depth differs by more than this share lie on two surfaces.
MIN_JUMP = 0.1
# A pixel that differs by this many grey levels has a weight of 1/e.
GREY_SCALE = 10.0


def align_edges(
    # inverse_depth, deviation, frame: (H, W) float32, the frame has grey levels. If any inverse
    # depth is not finite, nothing changes.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse depth and its deviation, with edges moved to the image edges nearby."""
    if not np.isfinite(inverse_depth).all():
        return inverse_depth, deviation
    depth = np.ascontiguousarray(inverse_depth)
    std = np.ascontiguousarray(deviation)
    out, out_deviation = np.empty((2, *depth.shape), np.float32)
    by_look(depth, std, _surface_threshold(depth), frame, out, out_deviation, similar=GREY_SCALE)
    return out, out_deviation


def _surface_threshold(inverse_depth: np.ndarray) -> np.ndarray:
    """Return the geometric mean of the extremes in a window around a depth edge; elsewhere 0."""
    neighbourhood, window = (np.ones((side, side), np.uint8) for side in (3, 2 * RADIUS + 1))
    edge = _has_edge(inverse_depth, neighbourhood)
    # Pixels so near to the edge that the window holds pixels of both surfaces.
    near_edge = cv2.dilate(edge.astype(np.uint8), np.ones((2 * RADIUS - 1,) * 2, np.uint8)) > 0
    lowest, highest = cv2.erode(inverse_depth, window), cv2.dilate(inverse_depth, window)
    return np.where(near_edge, np.sqrt(lowest * highest), np.float32(0))


def _has_edge(inverse_depth: np.ndarray, window: np.ndarray) -> np.ndarray:
    highest = cv2.dilate(inverse_depth, window)
    has_edge: np.ndarray = highest - cv2.erode(inverse_depth, window) > MIN_JUMP * highest
    return has_edge
