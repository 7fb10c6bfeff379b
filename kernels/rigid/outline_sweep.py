"""Matching costs of several frames from small census transforms, beside outlines of a keyframe.

A census transform of 5×5 pixels hardly reaches across an outline.
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
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model import MIN_DEPTH_RATIO

RADIUS = 2  # px: half the side of the window of a transform
BITS = (2 * RADIUS + 1) ** 2 - 1  # bits of a transform
NO_CODE = -1  # transform of a pixel that is not compared
MAX_BEST = 4  # limit of the frames in the mean of a cost
UNSEEN_COST = 0.5  # cost of a hypothesis that no frame shows
_UNUSED = 2.0  # larger than any cost of a frame


def census_transform(
    frame: np.ndarray,  # (H, W) float32: grey levels
    is_used: np.ndarray,  # (H, W) int32: pixels with 0 get `NO_CODE`
    out: np.ndarray,  # (H, W) int32
) -> None:
    """Tell of every neighbour in the window of a pixel whether it is darker: one bit for each.

    Neighbours outside the frame are replaced by the nearest pixel inside.

    References
    ----------
    Zabih, Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV
    1994, doi 10.1007/BFb0028345.
    """
    check_array(frame, out.shape, "frame", aligned=False)
    check_array(is_used, out.shape, "is_used", dtype=np.int32, aligned=False)
    check_array(out, out.shape, "out", dtype=np.int32, aligned=False)
    _census_transform(frame, is_used, out)


@Kernel
def _census_transform(
    frame: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    is_used: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
    out: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
):
    height, width = frame.shape[0], frame.shape[1]
    for y, x in ti.ndrange(height, width):
        code, grey, bit = 0, frame[y, x], 1
        for dy, dx in ti.static(ti.ndrange((-RADIUS, RADIUS + 1), (-RADIUS, RADIUS + 1))):
            if ti.static(dy != 0 or dx != 0):
                row = ti.max(0, ti.min(y + dy, height - 1))
                column = ti.max(0, ti.min(x + dx, width - 1))
                if frame[row, column] < grey:
                    code = code | bit
                bit = bit * 2
        if is_used[y, x] == 0:
            code = NO_CODE
        out[y, x] = code


def outline_cost(
    census0: np.ndarray,  # (H, W) int32: transform of the keyframe
    census1: np.ndarray,  # (M, H, W) int32: transforms of the other frames
    motions: np.ndarray,  # (M, 3, 4) float32: R and t
    guess: np.ndarray,  # (h, w) float32: a likely inverse depth of a block, px/frame
    is_free: np.ndarray,  # (h, w) int32: 1 where frames are compared
    # (h, w, N[, lanes]) float32: costs of the hypotheses D = first + n·step. Number n is in vector
    # n // lanes, lane n % lanes.
    out: np.ndarray,
    *,
    origin: tuple[int, int],  # row and column of the first pixel of the block
    center: tuple[float, float],  # principal point, px
    focal: float,  # px
    # first, step: px/frame
    first: float,
    step: float,
    best_count: int,  # frames with the least costs whose mean is the cost; 1 to `MAX_BEST`
    # cost of a hypothesis far from the guess, and the distance at which it is reached, px/frame, of
    # free pixels and of the others
    guess_costs: tuple[float, float],
    guess_distances: tuple[float, float],
) -> None:
    """Compute the costs of a block of pixels of a keyframe for several inverse depths.

    The cost of a frame is the share of differing bits at the pixel nearest to the target. The cost
    of a hypothesis is the mean of the least costs of the frames that show it, since some frames do
    not see a surface behind an outline. cost·min(1, |D − guess|/distance) is added; at
    pixels that are not free, this is the whole cost.
    """
    count, height, width = census1.shape
    rows, columns = guess.shape
    lanes = 1 if out.ndim == 3 else out.shape[3]
    check_array(census0, (height, width), "census0", dtype=np.int32, aligned=False)
    check_array(census1, (count, height, width), "census1", dtype=np.int32, aligned=False)
    check_array(motions, (count, 3, 4), "motions", aligned=False)
    check_array(guess, (rows, columns), "guess", aligned=False)
    check_array(is_free, (rows, columns), "is_free", dtype=np.int32, aligned=False)
    check_array(out, (rows, columns, *out.shape[2:]), "out")
    if not 1 <= best_count <= MAX_BEST:
        raise ValueError(f"best_count is {best_count}: expected 1 to {MAX_BEST}")
    if origin[0] + rows > height or origin[1] + columns > width:
        raise ValueError(f"the block at {origin} is not inside the frame")
    _outline_cost[lanes](
        census0, census1, motions, guess, is_free, *origin, *map(float, center), focal, first, step,
        best_count, 1 / BITS, *guess_costs, *(1 / distance for distance in guess_distances), out,
    )  # fmt: skip


@lane_kernel
def _outline_cost(
    census0: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
    census1: ti.types.ndarray(dtype=ti.i32, ndim=3),  # (M, H, W)
    motions: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (M, 3, 4)
    guess: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (h, w)
    is_free: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (h, w)
    first_row: ti.i32,
    first_column: ti.i32,
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    first: ti.f32,
    step: ti.f32,
    best_count: ti.i32,
    unit: ti.f32,
    free_cost: ti.f32,
    fixed_cost: ti.f32,
    free_scale: ti.f32,
    fixed_scale: ti.f32,
    out: LaneArray(3),  # (h, w, N)
):
    height, width = census0.shape[0], census0.shape[1]
    lanes = ti.static(lane_count(out))
    for i, j in ti.ndrange(guess.shape[0], guess.shape[1]):
        y, x = i + first_row, j + first_column
        x_hat, y_hat = (x - cx) / focal, (y - cy) / focal
        code = census0[y, x]
        count, unseen_cost, guess_cost, scale = 0, 0.0, fixed_cost, fixed_scale
        if is_free[i, j] > 0:
            count, unseen_cost, guess_cost, scale = (
                census1.shape[0],
                UNSEEN_COST,
                free_cost,
                free_scale,
            )
        hypothesis = 0.0 * out[i, j, 0] + first
        for lane in ti.static(range(1, lanes)):
            hypothesis[lane] = first + lane * step
        for n in range(out.shape[2]):
            # the least costs, in ascending order; `_UNUSED` if fewer frames show the point
            best0 = 0.0 * hypothesis + _UNUSED
            best1, best2, best3 = best0, best0, best0
            for k in range(count):
                # The moved point is p + D t / f, in units of its depth before the motion; x and y
                # are multiplied by f.
                p1 = motions[k, 0, 0] * x_hat + motions[k, 0, 1] * y_hat + motions[k, 0, 2]
                p2 = motions[k, 1, 0] * x_hat + motions[k, 1, 1] * y_hat + motions[k, 1, 2]
                p3 = motions[k, 2, 0] * x_hat + motions[k, 2, 1] * y_hat + motions[k, 2, 2]
                nearness = 1.0 / ti.max(
                    p3 + hypothesis * (motions[k, 2, 3] / focal), MIN_DEPTH_RATIO
                )
                column = ti.floor(
                    cx + nearness * (focal * p1 + hypothesis * motions[k, 0, 3]) + 0.5
                )
                row = ti.floor(cy + nearness * (focal * p2 + hypothesis * motions[k, 1, 3]) + 0.5)
                excess = ti.max(
                    ti.max(0.0 - column, column - (width - 1.0)),
                    ti.max(0.0 - row, row - (height - 1.0)),
                )
                value = 0.0 * hypothesis + _UNUSED
                for lane in ti.static(range(lanes)):
                    if lane_of(excess, lane, lanes) <= 0.0:
                        y1 = ti.cast(lane_of(row, lane, lanes), ti.i32)
                        x1 = ti.cast(lane_of(column, lane, lanes), ti.i32)
                        other = census1[k, y1, x1]
                        if other >= 0:
                            difference = ti.math.popcnt(code ^ other)
                            set_lane(value, lane, lanes, unit * ti.cast(difference, ti.f32))
                least = ti.min(best0, value)
                value = ti.max(best0, value)
                best0 = least
                least = ti.min(best1, value)
                value = ti.max(best1, value)
                best1 = least
                least = ti.min(best2, value)
                value = ti.max(best2, value)
                best2 = least
                best3 = ti.min(best3, value)
            total, seen = _counted(best0), _is_seen(best0)
            if best_count > 1:
                total, seen = total + _counted(best1), seen + _is_seen(best1)
            if best_count > 2:
                total, seen = total + _counted(best2), seen + _is_seen(best2)
            if best_count > 3:
                total, seen = total + _counted(best3), seen + _is_seen(best3)
            total = total + unseen_cost * (1.0 - ti.min(seen, 1.0))
            difference = scale * (hypothesis - guess[i, j])
            difference = ti.min(1.0, ti.max(difference, 0.0 - difference))
            out[i, j, n] = total / ti.max(seen, 1.0) + guess_cost * difference
            hypothesis = hypothesis + lanes * step


@ti.func
def _is_seen(cost):
    """Return 1 for a cost of a frame, and 0 for `_UNUSED`."""
    return ti.min(1.0, ti.max(0.0, 2.0 * (1.5 - cost)))


@ti.func
def _counted(cost):
    """Return the cost of a frame, and 0 for `_UNUSED`."""
    return cost * _is_seen(cost)
