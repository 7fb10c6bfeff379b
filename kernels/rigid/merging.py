"""Merging of several inverse depth maps of one view by votes.

Each source has a vote for every pixel, with the weight (d/σ)². The source with most votes in
agreement determines the surface of the pixel. The result is the weighted mean of these votes.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

SUREST = 1e-3  # share of the inverse depth: smaller deviations count as this value


def merged(
    # (N, H, W) float32: 0 where a source has no depth. If two sources have equal votes, the first
    # is used.
    inverse_depths: np.ndarray,
    deviations: np.ndarray,  # (N, H, W) float32: their standard deviations; finite
    # out, out_deviation: (H, W) float32, means of the sources that agree, with the weights (d/σ)²;
    # 0 where there is no depth. The deviation is a mean too, not smaller than those of the sources,
    # since sources share images.
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    # largest relative difference, as a share of the larger value, for two sources to agree
    alike: float,
) -> None:
    """Merge the inverse depth of several sources, pixel by pixel.

    Raises TypeError, ValueError if an array is not of these types and sizes.

    Notes
    -----
    Values must be finite: with fast math, comparisons with NaN are unreliable.
    """
    shape = np.shape(inverse_depths)
    if len(shape) != 3:
        raise ValueError(f"inverse_depths is {shape}: expected (N, H, W)")
    check_array(inverse_depths, shape, "inverse_depths", aligned=False)
    check_array(deviations, shape, "deviations", aligned=False)
    check_array(out, shape[1:], "out", aligned=False)
    check_array(out_deviation, shape[1:], "out_deviation", aligned=False)
    _merged(inverse_depths, deviations, float(alike), out, out_deviation)


@Kernel
def _merged(
    inverse_depths: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    deviations: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    alike: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        most, depth, deviation = 0.0, 0.0, 0.0
        for i in range(inverse_depths.shape[0]):
            mine = inverse_depths[i, y, x]
            if mine > 0.0:
                votes, sum_depth, sum_deviation = 0.0, 0.0, 0.0
                for j in range(inverse_depths.shape[0]):
                    other, spread = inverse_depths[j, y, x], deviations[j, y, x]
                    apart = ti.max(mine - other, other - mine)
                    if other > 0.0 and apart < alike * ti.max(mine, other):
                        vote = other / ti.max(spread, SUREST * other)
                        vote *= vote
                        votes += vote
                        sum_depth += vote * other
                        sum_deviation += vote * spread
                if votes > most:
                    most = votes
                    depth = sum_depth / votes
                    deviation = sum_deviation / votes
        out[y, x] = depth
        out_deviation[y, x] = deviation
