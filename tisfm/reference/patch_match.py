"""Costs of planes: how a window of frame 0 correlates with where frame 1 would show it."""

import numpy as np

from tisfm.camera import Camera

RADIUS, SIMILAR = 5, 20.0  # px; grey levels


def plane_cost(
    levels0: np.ndarray,
    levels1: np.ndarray,
    planes: np.ndarray,
    camera: Camera,
    rotation: np.ndarray,
    translation: np.ndarray,
    *,
    noise: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return 1 − c of a plane at every pixel, c the weighted correlation of its window.

    The window has every second pixel of 11×11, without corners; beyond both images their borders
    repeat. A pixel that differs from the centre by n·`SIMILAR` levels weighs
    1/(1 + n + n²/2 + n³/6).

    Parameters
    ----------
    levels0, levels1 : (H, W)
        Grey levels.
    planes : (3, H, W)
        D, px/frame, and its slopes.
    rotation, translation : (3, 3) and (3,)
    noise : float
        Variance that is added to those of both windows.

    Returns
    -------
    cost, variance : (H, W)
        1 − c, and the variance of the window of frame 0.
    """
    height, width = levels0.shape
    cx, cy = camera.center_for(height, width)
    rows, columns = np.indices(levels0.shape)
    padded = np.pad(levels0, RADIUS, "edge")
    total, sums = 0.0, np.zeros((5, height, width))
    offsets = range(-RADIUS, RADIUS + 1, 2)
    for down, across in ((j, i) for j in offsets for i in offsets if abs(i * j) < RADIUS**2):
        window = padded[RADIUS + down :, RADIUS + across :][:height, :width]
        grey0 = window - levels0
        apart = np.abs(grey0) / SIMILAR
        weight = 1 / (1 + apart + apart**2 / 2 + apart**3 / 6)
        x, y = columns + across - cx, rows + down - cy
        ray = np.stack([x / camera.focal, y / camera.focal, np.ones_like(x)])
        inverse_depth = (planes[0] + planes[1] * across + planes[2] * down) / camera.focal
        moved = np.einsum("ij,jyx->iyx", rotation, ray)
        moved += translation[:, None, None] * inverse_depth
        there = camera.focal * moved[:2] / moved[2]
        grey1 = _bilinear(levels1, cy + there[1], cx + there[0]) - levels0
        total = total + weight
        sums += weight * np.stack([grey0, grey1, grey0**2, grey1**2, grey0 * grey1])
    mean0, mean1, square0, square1, product = sums / total
    variance0, variance1 = square0 - mean0**2, square1 - mean1**2
    correlation = (product - mean0 * mean1) / np.sqrt((variance0 + noise) * (variance1 + noise))
    return 1 - correlation, variance0


def plane_disagreement(
    planes0: np.ndarray,
    planes1: np.ndarray,
    camera: Camera,
    rotation: np.ndarray,
    translation: np.ndarray,
) -> np.ndarray:
    """Return how far D of frame 0 is, in frame 1, from what the nearest pixel's plane says there.

    Parameters
    ----------
    planes0, planes1 : (3, H, W)
        D, px/frame, and its slopes, of both frames; D of frame 1 is infinite where it is unknown.
    rotation, translation : (3, 3) and (3,)
        From frame 0 to frame 1.

    Returns
    -------
    (H, W)
        px/frame; infinite where the pixel leaves the image, or nothing is known there.
    """
    height, width = planes0.shape[1:]
    cx, cy = camera.center_for(height, width)
    rows, columns = np.indices((height, width))
    x_hat, y_hat = (columns - cx) / camera.focal, (rows - cy) / camera.focal
    moved = np.einsum("ij,jyx->iyx", rotation, np.stack([x_hat, y_hat, np.ones_like(x_hat)]))
    moved += translation[:, None, None] * planes0[0] / camera.focal
    u, v = cx + camera.focal * moved[0] / moved[2], cy + camera.focal * moved[1] / moved[2]
    column, row = np.floor(u + 0.5).astype(int), np.floor(v + 0.5).astype(int)
    inside = (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    depth, east, south = planes1[:, row.clip(0, height - 1), column.clip(0, width - 1)]
    back = depth + east * (u - column) + south * (v - row)
    return np.where(inside, np.abs(back - planes0[0] / moved[2]), np.inf)


def _bilinear(image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    height, width = image.shape
    rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
    top, left = np.floor(rows).astype(int), np.floor(columns).astype(int)
    bottom, right = np.minimum(top + 1, height - 1), np.minimum(left + 1, width - 1)
    b, a = rows - top, columns - left
    above = (1 - a) * image[top, left] + a * image[top, right]
    below = (1 - a) * image[bottom, left] + a * image[bottom, right]
    return (1 - b) * above + b * below
