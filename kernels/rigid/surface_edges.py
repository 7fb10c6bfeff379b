"""Assignment of pixels near a depth edge to one of the two surfaces, by grey level.

Each pixel around has a vote for the surface that it shows. The vote has more weight if the pixel is
nearer and if its grey level is more similar.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

RADIUS = 3  # px: half side of the window whose pixels vote
FADING = 0.1  # 1/px²: a pixel at distance r px has the weight 1/(1 + 0.1 r²)


def by_look(
    # inverse_depth, deviation: (H, W) float32, positive; finite
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (H, W) float32: inverse depth that separates two surfaces nearby; 0 where there is only one
    # surface
    middle: np.ndarray,
    frame: np.ndarray,  # (H, W) float32: grey levels
    # out, out_deviation: (H, W) float32, the same values, but where most votes are for the other
    # surface, the weighted mean over its pixels
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    similar: float,  # grey levels: a pixel with this difference has the weight 1/e
) -> None:
    """Move depth edges to edges of the frame.

    Raises TypeError, ValueError if an array is not of these types and sizes.
    """
    shape = inverse_depth.shape
    for name, array in (
        ("inverse_depth", inverse_depth),
        ("deviation", deviation),
        ("middle", middle),
        ("frame", frame),
        ("out", out),
        ("out_deviation", out_deviation),
    ):
        check_array(array, shape, name, aligned=False)
    _by_look(inverse_depth, deviation, middle, frame, float(similar), out, out_deviation)


@Kernel
def _by_look(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    middle: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    frame: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    similar: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    height, width = frame.shape[0], frame.shape[1]
    for y, x in ti.ndrange(height, width):
        depth, spread, limit = inverse_depth[y, x], deviation[y, x], middle[y, x]
        if limit > 0.0:
            mine, level = depth > limit, frame[y, x]
            votes, other, sum_depth, sum_spread = 0.0, 0.0, 0.0, 0.0
            for row in range(ti.max(0, y - RADIUS), ti.min(height, y + RADIUS + 1)):
                for column in range(ti.max(0, x - RADIUS), ti.min(width, x + RADIUS + 1)):
                    unlike = ti.max(frame[row, column] - level, level - frame[row, column])
                    square = ti.cast((row - y) * (row - y) + (column - x) * (column - x), ti.f32)
                    vote = ti.exp(0.0 - unlike / similar) / (1.0 + FADING * square)
                    if (inverse_depth[row, column] > limit) == mine:
                        votes += vote
                    else:
                        other += vote
                        sum_depth += vote * inverse_depth[row, column]
                        sum_spread += vote * deviation[row, column]
            if other > votes:
                depth, spread = sum_depth / other, sum_spread / other
        out[y, x] = depth
        out_deviation[y, x] = spread
