"""The smoothness term of the unknowns: its strength, and its image-driven factor.

The image-driven factor g weakens smoothness across contours of the image, where motion may change
abruptly. An edge joins two neighbouring pixels. Equations are numbered as in the paper
(docs/method.md). A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.kernels.data.image_edges import image_edges
from tisfm.kernels.layout.lanes import LaneData, LaneGrid

MIN_GREY_STEP = 1e-5  # grey levels, about the resolution of float32: uniform frames have no edges


@dataclass(frozen=True, kw_only=True)
class Smoothness:
    """Smoothness of the unknowns: α Σ g Φ_δ over all edges, with Φ_δ a penalty (eq. 6, 14)."""

    alpha: float  # α, the strength of the smoothness: λ̂β of the paper
    contrast: float  # δ, px/frame; infinite for quadratic smoothness
    stiffness: tuple[float, ...]  # s_k of each unknown
    joint: bool  # whether all unknowns share the weight of an edge
    image_edges: float  # κ, the strength of the image-driven factor; 0 for g = 1


def mean_step(frame: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Return the mean |ΔI| between neighbours of a frame, (H, W): its contrast.

    With `valid`, (H, W) bool, the mean is over pairs of used neighbours; 0 without such pairs.
    """
    if valid is not None:
        is_row_pair, is_column_pair = valid[:, 1:] & valid[:, :-1], valid[1:] & valid[:-1]
        total = float(np.abs(np.diff(frame, axis=1))[is_row_pair].sum(dtype=np.float64))
        total += float(np.abs(np.diff(frame, axis=0))[is_column_pair].sum(dtype=np.float64))
        return total / max(int(is_row_pair.sum()) + int(is_column_pair.sum()), 1)
    height, width = frame.shape
    count = height * (width - 1) + (height - 1) * width
    total = cv2.norm(frame[:, 1:], frame[:, :-1], cv2.NORM_L1) if width > 1 else 0.0
    total += cv2.norm(frame[1:], frame[:-1], cv2.NORM_L1) if height > 1 else 0.0
    return total / max(count, 1)


def image_driven_factor(
    grid: LaneGrid,
    frame: np.ndarray,  # (H, W) float32: grey levels
    strength: float,  # κ; 0 for g = 1
    # (H, W) bool: the pixels over which m is a mean, by default all
    valid: np.ndarray | None = None,
) -> LaneData:  # lane array, 2 components: eastern and southern edges; 0 across the border
    """Return g = c/(1 + κ|ΔI|/m) of every edge, with m the mean |ΔI| and c such that mean g is 1.

    g depends only on the contrast of an edge relative to the mean contrast of the frame. It keeps
    the mean strength of the smoothness.
    """
    out = grid.allocate(2)
    mean_difference = max(mean_step(frame, valid), MIN_GREY_STEP)
    image_edges(grid, frame, out, rate=strength / mean_difference)
    return out
