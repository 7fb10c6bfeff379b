"""Costs of planes: how a window of frame 0 correlates with where frame 1 would show it."""

import numpy as np

from tisfm.camera import Camera

RADIUS, SIMILAR = 5, 20.0  # px; grey levels


def plane_cost(
    levels0: np.ndarray,
    levels1: np.ndarray,
    plane: np.ndarray,
    pixel: tuple[int, int],
    camera: Camera,
    rotation: np.ndarray,
    translation: np.ndarray,
    *,
    noise: float,
) -> float:
    """Return 1 − c of a plane at a pixel, c the weighted correlation of its window.

    The window has every second pixel of 11×11, without corners; beyond both images their borders
    repeat. A pixel that differs from the centre by n·`SIMILAR` levels weighs
    1/(1 + n + n²/2 + n³/6).

    Parameters
    ----------
    levels0, levels1 : (H, W)
        Grey levels.
    plane : (3,)
        D, px/frame, and its slopes.
    pixel : (int, int)
        Row and column.
    rotation, translation : (3, 3) and (3,)
    noise : float
        Variance that is added to those of both windows.
    """
    row, column = pixel
    height, width = levels0.shape
    offsets = np.arange(-RADIUS, RADIUS + 1, 2)
    down, across = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    inner = (np.abs(down) < RADIUS) | (np.abs(across) < RADIUS)
    down, across = down[inner], across[inner]
    rows, columns = row + down, column + across
    grey0 = levels0[rows.clip(0, height - 1), columns.clip(0, width - 1)]
    apart = np.abs(grey0 - levels0[row, column]) / SIMILAR
    weight = 1 / (1 + apart + apart**2 / 2 + apart**3 / 6)
    weight /= weight.sum()
    cx, cy = camera.center_for(height, width)
    ray = np.stack([(columns - cx) / camera.focal, (rows - cy) / camera.focal, np.ones(len(rows))])
    inverse_depth = (plane[0] + plane[1] * across + plane[2] * down) / camera.focal
    moved = rotation @ ray + translation[:, None] * inverse_depth
    grey1 = _bilinear(
        levels1, cy + camera.focal * moved[1] / moved[2], cx + camera.focal * moved[0] / moved[2]
    )
    apart0, apart1 = grey0 - weight @ grey0, grey1 - weight @ grey1
    variances = (weight @ apart0**2 + noise) * (weight @ apart1**2 + noise)
    return 1 - weight @ (apart0 * apart1) / np.sqrt(variances)


def _bilinear(image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    height, width = image.shape
    rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
    top, left = np.floor(rows).astype(int), np.floor(columns).astype(int)
    bottom, right = np.minimum(top + 1, height - 1), np.minimum(left + 1, width - 1)
    b, a = rows - top, columns - left
    above = (1 - a) * image[top, left] + a * image[top, right]
    below = (1 - a) * image[bottom, left] + a * image[bottom, right]
    return (1 - b) * above + b * below
