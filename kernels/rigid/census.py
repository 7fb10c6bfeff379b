"""Matching costs from census transforms, for wide sweeps over inverse depth.

A census transform tells of every neighbour of a pixel whether it is darker than the pixel. It does
not change with gain and offset of the grey levels.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import (
    LaneArray,
    check_array,
    lane_count,
    lane_kernel,
    lane_of,
    set_lane,
)
from tisfm.kernels.model import MIN_DEPTH_RATIO

WORDS = 2  # words of a transform
BITS = 24  # bits that a word holds


def census_cost(
    # census0, census1: (H, W, 2) int32: transforms of both frames, 24 bits in each word
    census0: np.ndarray,
    census1: np.ndarray,
    motion: np.ndarray,  # (3, 4) float32: R and t
    # (H, W, M[, lanes]) float32: costs of the hypotheses D = first + n·step. Number n is in vector
    # n // lanes, lane n % lanes.
    out: np.ndarray,
    *,
    center: tuple[float, float],  # principal point, px
    focal: float,  # px
    # first, step: px/frame
    first: float,
    step: float,
) -> None:
    """Compute the share of differing bits for every pixel of frame 0 and several inverse depths.

    Frame 1 is read at the pixel nearest to the target. The cost is 1 if the hypothesis moves the
    pixel out of the image.

    References
    ----------
    Zabih, Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV
    1994, doi 10.1007/BFb0028345.
    """
    height, width = census0.shape[:2]
    lanes = 1 if out.ndim == 3 else out.shape[3]
    for name, array in (("census0", census0), ("census1", census1)):
        check_array(array, (height, width, WORDS), name, dtype=np.int32, aligned=False)
    check_array(out, (height, width, *out.shape[2:]), "out")
    check_array(motion, (3, 4), "motion", aligned=False)
    _census_cost[lanes](
        census0, census1, motion, *map(float, center), focal, first, step, 1 / (WORDS * BITS), out
    )


@lane_kernel
def _census_cost(
    census0: ti.types.ndarray(dtype=ti.i32, ndim=3),  # (H, W, 2)
    census1: ti.types.ndarray(dtype=ti.i32, ndim=3),  # (H, W, 2)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    first: ti.f32,
    step: ti.f32,
    unit: ti.f32,
    out: LaneArray(3),  # (H, W, M)
):
    height, width = census0.shape[0], census0.shape[1]
    lanes = ti.static(lane_count(out))
    for y, x in ti.ndrange(height, width):
        x_hat, y_hat = (x - cx) / focal, (y - cy) / focal
        # The moved point is p + D t / f, in units of its depth before the motion; x and y are
        # multiplied by f.
        p1 = focal * (motion[0, 0] * x_hat + motion[0, 1] * y_hat + motion[0, 2])
        p2 = focal * (motion[1, 0] * x_hat + motion[1, 1] * y_hat + motion[1, 2])
        p3 = motion[2, 0] * x_hat + motion[2, 1] * y_hat + motion[2, 2]
        t1, t2, t3 = motion[0, 3], motion[1, 3], motion[2, 3] / focal
        word0, word1 = census0[y, x, 0], census0[y, x, 1]
        hypothesis = 0.0 * out[y, x, 0] + first
        for lane in ti.static(range(1, lanes)):
            hypothesis[lane] = first + lane * step
        for m in range(out.shape[2]):
            nearness = 1.0 / ti.max(p3 + hypothesis * t3, MIN_DEPTH_RATIO)
            column = ti.floor(cx + nearness * (p1 + hypothesis * t1) + 0.5)
            row = ti.floor(cy + nearness * (p2 + hypothesis * t2) + 0.5)
            excess = ti.max(
                ti.max(0.0 - column, column - (width - 1.0)),
                ti.max(0.0 - row, row - (height - 1.0)),
            )
            value = 0.0 * hypothesis + 1.0
            for lane in ti.static(range(lanes)):
                if lane_of(excess, lane, lanes) <= 0.0:
                    y1 = ti.cast(lane_of(row, lane, lanes), ti.i32)
                    x1 = ti.cast(lane_of(column, lane, lanes), ti.i32)
                    difference = ti.math.popcnt(word0 ^ census1[y1, x1, 0])
                    difference += ti.math.popcnt(word1 ^ census1[y1, x1, 1])
                    set_lane(value, lane, lanes, unit * ti.cast(difference, ti.f32))
            out[y, x, m] = value
            hypothesis = hypothesis + lanes * step
