"""Pixels that the flow moves to one position: the reference of `tisfm.visibility.occlusion`."""

import numpy as np


def splat(flow: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return Σw, Σw·residual, Σw·u, Σw·v, (4, H, W), at every pixel of frame 1.

    w are the bilinear weights of the pixels of frame 0 whose target x + flow lies within 1 px.
    """
    _, height, width = flow.shape
    found = np.zeros((4, height, width))
    values = np.stack([np.ones_like(residual), residual, *flow])
    for row, column in np.ndindex(height, width):
        x, y = column + flow[0, row, column], row + flow[1, row, column]
        if 0 <= x <= width - 1 and 0 <= y <= height - 1:
            for below, right, weight in _bilinear(x, y, height, width):
                found[:, below, right] += weight * values[:, row, column]
    return found


def defeated(flow: np.ndarray, residual: np.ndarray, *, density: float, apart: float) -> np.ndarray:
    """Return hidden pixels: pixels of another flow and smaller residual have the same target."""
    _, height, width = flow.shape
    sums = splat(flow, residual)
    found = np.zeros((height, width), bool)
    for row, column in np.ndindex(height, width):
        x, y = column + flow[0, row, column], row + flow[1, row, column]
        if 0 <= x <= width - 1 and 0 <= y <= height - 1:
            around = _bilinear(x, y, height, width)
            total, *means = np.sum([w * sums[:, j, i] for j, i, w in around], axis=0)
            mean_residual, u, v = np.array(means) / total
            distance = np.hypot(u - flow[0, row, column], v - flow[1, row, column])
            worse = residual[row, column] > mean_residual
            found[row, column] = total > density and distance > apart and worse
    return found


def _bilinear(x: float, y: float, height: int, width: int) -> list[tuple[int, int, float]]:
    """Return row, column and weight of the four pixels around a position."""
    left, top = int(x), int(y)
    right, below = min(left + 1, width - 1), min(top + 1, height - 1)
    across, down = x - left, y - top
    return [
        (top, left, (1 - across) * (1 - down)),
        (top, right, across * (1 - down)),
        (below, left, (1 - across) * down),
        (below, right, across * down),
    ]
