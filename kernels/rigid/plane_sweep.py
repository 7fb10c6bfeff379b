"""Costs of hypotheses of inverse depth, by comparing frame 0 with where frame 1 would show it."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model.constants import NEAREST


def matching_cost(
    features0: np.ndarray,
    features1: np.ndarray,
    guess: np.ndarray,
    weight: np.ndarray,
    motion: np.ndarray,
    out: np.ndarray,
    *,
    center: tuple[float, float],
    focal: float,
    first: float,
    step: float,
    count: int,
    near: float,
) -> None:
    """Compare every pixel of frame 0 with frame 1 at `count` inverse depths.

    A cost is min(1, |ΔI|) + min(1, |ΔI_x| + |ΔI_y|), in the units that the features have, and 1
    where a hypothesis takes the pixel out of the image; to which weight·min(1, |D − guess|/near)
    is added.

    Parameters
    ----------
    features0, features1 : (H, W, 4) float32
        Brightness, its derivatives in x and in y, and nothing, of both frames.
    guess, weight : (H, W) float32
        An inverse depth that is likely, px/frame, and how likely.
    motion : (3, 4) float32
        R and t.
    out : (H, W, N) float32
        Of hypothesis n, D = first + n·step. What is beyond `count` is left alone.
    center : (float, float)
        Principal point, px.
    focal : float
        px.
    first, step : float
        px/frame.
    count : int
    near : float
        px/frame.
    """
    height, width, size = out.shape
    for name, array, shape in (
        ("features0", features0, (height, width, 4)),
        ("features1", features1, (height, width, 4)),
        ("out", out, (height, width, size)),
    ):
        check_array(array, shape, name)
    check_array(guess, (height, width), "guess", aligned=False)
    check_array(weight, (height, width), "weight", aligned=False)
    check_array(motion, (3, 4), "motion", aligned=False)
    if not 0 < count <= size:
        raise ValueError(f"count is {count}: expected 1 to {size}")
    _matching_cost(
        features0,
        features1,
        guess,
        weight,
        motion,
        *map(float, center),
        focal,
        first,
        step,
        1 / near,
        count,
        out,
    )


@Kernel
def _matching_cost(
    features0: ti.types.ndarray(dtype=ti.types.vector(4, ti.f32), ndim=2),  # (H, W)
    features1: ti.types.ndarray(dtype=ti.types.vector(4, ti.f32), ndim=2),  # (H, W)
    guess: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    weight: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    first: ti.f32,
    step: ti.f32,
    inverse_near: ti.f32,
    count: ti.i32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (H, W, N)
):
    height, width = features1.shape[0], features1.shape[1]
    for y, x in ti.ndrange(height, width):
        x_hat, y_hat = (x - cx) / focal, (y - cy) / focal
        p1 = motion[0, 0] * x_hat + motion[0, 1] * y_hat + motion[0, 2]
        p2 = motion[1, 0] * x_hat + motion[1, 1] * y_hat + motion[1, 2]
        p3 = motion[2, 0] * x_hat + motion[2, 1] * y_hat + motion[2, 2]
        here = features0[y, x]
        for n in range(count):
            hypothesis = first + n * step
            d = hypothesis / focal
            nearness = focal / ti.max(p3 + d * motion[2, 3], NEAREST)
            x_there = cx + nearness * (p1 + d * motion[0, 3])
            y_there = cy + nearness * (p2 + d * motion[1, 3])
            value = 1.0
            if x_there >= 0 and x_there <= width - 1 and y_there >= 0 and y_there <= height - 1:
                column = ti.min(ti.cast(x_there, ti.i32), ti.max(width - 2, 0))
                row = ti.min(ti.cast(y_there, ti.i32), ti.max(height - 2, 0))
                right, below = ti.min(column + 1, width - 1), ti.min(row + 1, height - 1)
                a, b = x_there - column, y_there - row
                there = (1.0 - b) * (
                    (1.0 - a) * features1[row, column] + a * features1[row, right]
                ) + b * ((1.0 - a) * features1[below, column] + a * features1[below, right])
                apart = there - here
                apart = ti.max(apart, 0.0 - apart)
                value = ti.min(1.0, apart[0]) + ti.min(1.0, apart[1] + apart[2])
            away = inverse_near * (hypothesis - guess[y, x])
            out[y, x, n] = value + weight[y, x] * ti.min(1.0, ti.max(away, 0.0 - away))
