"""Matches of a keyframe that belong to the contour of a nearer surface (foreground fattening)."""

import numpy as np

from tisfm.kernels.rigid.foreground_fattening import find_fattened
from tisfm.motion.matched_planes import noise_deviation
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.window_planes import Window
from tisfm.solver.second_order import SecondOrderSettings, extend_depth


def remove_fattened(
    window: Window,
    anchors: np.ndarray,  # (2, h, w) float32: weight of each cell, and its matched D, cells
    smoothness: SecondOrderSettings,
) -> np.ndarray:
    """Return the weights and matches; fattened matches have the weight 0.

    Depth propagated from all matches shows which side of a contour is nearer. A coarse grid is
    enough, since the depth of both sides is taken far from the contour.
    """
    frame = window.at_cell_level(0)
    halvings = 0
    while frame.size >> 2 * halvings > DEPTH.max_surface_cells:
        halvings += 1
    depth, _ = extend_depth(
        anchors[1], anchors[0], frame, smoothness, iterations=1, last_level=halvings
    )
    side = 2 ** (window.level - window.finest_level)
    is_fattened = np.empty(frame.shape, np.int32)
    find_fattened(
        frame,
        np.maximum(depth, 0),
        np.ascontiguousarray(anchors[1]),
        is_fattened,
        contour_distance=max(1, DEPTH.contour_distance // side),
        surface_distance=max(3, DEPTH.surface_distance // side),
        contrast=DEPTH.contour_contrast,
        min_contrast=DEPTH.contour_noise * noise_deviation(frame),
        min_step=DEPTH.min_surface_step,
        max_difference=DEPTH.max_contour_difference,
    )
    return np.where(is_fattened > 0, np.float32(0), anchors)
