"""Edges of an inverse depth map, aligned with edges of the frame.

Each pixel in a window votes for the surface that it shows. The vote has more weight if the pixel is
nearer and if its grey level is more similar.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

VOTING_RADIUS = 3  # px: half side of the window whose pixels vote
DISTANCE_DECAY = 0.1  # 1/px²: a pixel at distance r px has the weight 1/(1 + 0.1 r²)


def align_depth_edges(
    # inverse_depth, deviation: (H, W) float32, positive; finite
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (H, W) float32: inverse depth that separates two surfaces nearby; 0 where there is only one
    # surface
    threshold: np.ndarray,
    frame: np.ndarray,  # (H, W) float32: grey levels
    # out, out_deviation: (H, W) float32: the same values; where most votes are for the other
    # surface, the weighted mean over the pixels of that surface
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    grey_decay: float,  # grey levels: a difference that reduces the weight of a pixel to 1/e
) -> None:
    """Move depth edges to edges of the frame.

    Raises TypeError, ValueError if an array is not of these types and sizes.
    """
    shape = inverse_depth.shape
    for name, array in (
        ("inverse_depth", inverse_depth),
        ("deviation", deviation),
        ("threshold", threshold),
        ("frame", frame),
        ("out", out),
        ("out_deviation", out_deviation),
    ):
        check_array(array, shape, name, aligned=False)
    _align_depth_edges(
        inverse_depth, deviation, threshold, frame, float(grey_decay), out, out_deviation
    )


@Kernel
def _align_depth_edges(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    threshold: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    frame: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    grey_decay: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    height, width = frame.shape[0], frame.shape[1]
    for y, x in ti.ndrange(height, width):
        depth, spread, pixel_threshold = inverse_depth[y, x], deviation[y, x], threshold[y, x]
        if pixel_threshold > 0.0:
            is_near, grey = depth > pixel_threshold, frame[y, x]
            votes, other_votes, sum_depth, sum_spread = 0.0, 0.0, 0.0, 0.0
            for row in range(ti.max(0, y - VOTING_RADIUS), ti.min(height, y + VOTING_RADIUS + 1)):
                for column in range(
                    ti.max(0, x - VOTING_RADIUS), ti.min(width, x + VOTING_RADIUS + 1)
                ):
                    difference = ti.max(frame[row, column] - grey, grey - frame[row, column])
                    square = ti.cast((row - y) * (row - y) + (column - x) * (column - x), ti.f32)
                    vote = ti.exp(0.0 - difference / grey_decay) / (1.0 + DISTANCE_DECAY * square)
                    if (inverse_depth[row, column] > pixel_threshold) == is_near:
                        votes += vote
                    else:
                        other_votes += vote
                        sum_depth += vote * inverse_depth[row, column]
                        sum_spread += vote * deviation[row, column]
            if other_votes > votes:
                depth, spread = sum_depth / other_votes, sum_spread / other_votes
        out[y, x] = depth
        out_deviation[y, x] = spread
