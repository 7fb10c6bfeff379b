"""Plane sweep: matching costs of frame 0 and frame 1 for several inverse depths."""

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


def matching_cost(
    # features0, features1: (H, W, 4) float32, brightness and its derivatives in x and in y of both
    # frames; the fourth value is unused
    features0: np.ndarray,
    features1: np.ndarray,
    # guess, weight: (H, W) float32, a likely inverse depth, px/frame, and the weight of the cost
    # for a difference from it
    guess: np.ndarray,
    weight: np.ndarray,
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
    guess_distance: float,  # difference from `guess` from which its cost is constant, px/frame
) -> None:
    """Compute the matching cost of every pixel of frame 0 for several inverse depths.

    A cost is min(1, |ΔI|) + min(1, |ΔI_x| + |ΔI_y|), in the units of the features, or 1 if the
    hypothesis moves the pixel out of the image. weight·min(1, |D − guess|/guess_distance) is
    added.
    """
    height, width = guess.shape
    lanes = 1 if out.ndim == 3 else out.shape[3]
    for name, array in (("features0", features0), ("features1", features1)):
        check_array(array, (height, width, 4), name)
    check_array(out, (height, width, *out.shape[2:]), "out")
    check_array(guess, (height, width), "guess", aligned=False)
    check_array(weight, (height, width), "weight", aligned=False)
    check_array(motion, (3, 4), "motion", aligned=False)
    _matching_cost[lanes](
        features0.reshape(-1, 4), features1.reshape(-1, 4), guess, weight, motion,
        *map(float, center), focal, first, step, 1 / guess_distance, out,
    )  # fmt: skip


@lane_kernel
def _matching_cost(
    features0: ti.types.ndarray(dtype=ti.types.vector(4, ti.f32), ndim=1),  # (H·W,)
    features1: ti.types.ndarray(dtype=ti.types.vector(4, ti.f32), ndim=1),  # (H·W,)
    guess: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    weight: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    first: ti.f32,
    step: ti.f32,
    guess_scale: ti.f32,
    out: LaneArray(3),  # (H, W, M)
):
    """Compute the costs of a vector of hypotheses at a time; each lane samples its own position."""
    height, width = guess.shape[0], guess.shape[1]
    lanes = ti.static(lane_count(out))
    for y, x in ti.ndrange(height, width):
        x_hat, y_hat = (x - cx) / focal, (y - cy) / focal
        # The moved point is p + D t / f, in units of its depth before the motion; x and y are
        # multiplied by f.
        p1 = focal * (motion[0, 0] * x_hat + motion[0, 1] * y_hat + motion[0, 2])
        p2 = focal * (motion[1, 0] * x_hat + motion[1, 1] * y_hat + motion[1, 2])
        p3 = motion[2, 0] * x_hat + motion[2, 1] * y_hat + motion[2, 2]
        t1, t2, t3 = motion[0, 3], motion[1, 3], motion[2, 3] / focal
        right_border, lower_border = width - 1.0, height - 1.0
        last_column, last_row = ti.max(width - 2.0, 0.0), ti.max(height - 2.0, 0.0)
        column_step, row_step = ti.min(1, width - 1), ti.min(1, height - 1) * width
        feature, guess_depth, guess_weight = features0[y * width + x], guess[y, x], weight[y, x]
        hypothesis = 0.0 * out[y, x, 0] + first
        for lane in ti.static(range(1, lanes)):
            hypothesis[lane] = first + lane * step
        for m in range(out.shape[2]):
            nearness = 1.0 / ti.max(p3 + hypothesis * t3, MIN_DEPTH_RATIO)
            x1 = cx + nearness * (p1 + hypothesis * t1)
            y1 = cy + nearness * (p2 + hypothesis * t2)
            excess = ti.max(
                ti.max(0.0 - x1, x1 - right_border), ti.max(0.0 - y1, y1 - lower_border)
            )
            column = ti.floor(ti.max(0.0, ti.min(x1, last_column)))
            row = ti.floor(ti.max(0.0, ti.min(y1, last_row)))
            a, b = x1 - column, y1 - row
            value = 0.0 * hypothesis + 1.0
            for lane in ti.static(range(lanes)):
                if lane_of(excess, lane, lanes) <= 0.0:
                    corner = ti.cast(lane_of(row, lane, lanes), ti.i32) * width
                    corner += ti.cast(lane_of(column, lane, lanes), ti.i32)
                    right = lane_of(a, lane, lanes)
                    above, below = features1[corner], features1[corner + row_step]
                    above = above + right * (features1[corner + column_step] - above)
                    below = below + right * (features1[corner + row_step + column_step] - below)
                    difference = above + lane_of(b, lane, lanes) * (below - above) - feature
                    difference = ti.max(difference, 0.0 - difference)
                    data_cost = ti.min(1.0, difference[0]) + ti.min(
                        1.0, difference[1] + difference[2]
                    )
                    set_lane(value, lane, lanes, data_cost)
            guess_difference = guess_scale * (hypothesis - guess_depth)
            out[y, x, m] = value + guess_weight * ti.min(
                1.0, ti.max(guess_difference, 0.0 - guess_difference)
            )
            hypothesis = hypothesis + lanes * step
