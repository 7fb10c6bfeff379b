"""Derivatives of frames, the warp of frame 1 to frame 0, and forward splatting."""

import numpy as np

Array = np.ndarray  # of float64


def derivatives(
    frame0: Array, frame1: Array, scheme: str, halo: int = 0
) -> tuple[Array, Array, Array]:
    """Return (I_x, I_y, I_t), each (H + 2·halo, W + 2·halo); border pixels are repeated outside.

    ``"cube"``: Horn and Schunck's 2×2×2 cube. ``"five_tap"``: (1, −8, 0, 8, −1)/12 on the mean of
    both frames, and their difference.
    """
    height, width = frame0.shape[0] + 2 * halo, frame0.shape[1] + 2 * halo
    a = np.pad(np.asarray(frame0, np.float64), 2 + halo, mode="edge")
    b = np.pad(np.asarray(frame1, np.float64), 2 + halo, mode="edge")

    def at(image: Array, dy: int, dx: int) -> Array:
        return image[2 + dy : 2 + dy + height, 2 + dx : 2 + dx + width]

    if scheme == "five_tap":
        mean = (a + b) / 2
        ix = (at(mean, 0, -2) - 8 * at(mean, 0, -1) + 8 * at(mean, 0, 1) - at(mean, 0, 2)) / 12
        iy = (at(mean, -2, 0) - 8 * at(mean, -1, 0) + 8 * at(mean, 1, 0) - at(mean, 2, 0)) / 12
        return ix, iy, at(b, 0, 0) - at(a, 0, 0)
    both, step = a + b, b - a
    ix = (at(both, 0, 1) + at(both, 1, 1) - at(both, 0, 0) - at(both, 1, 0)) / 4
    iy = (at(both, 1, 0) + at(both, 1, 1) - at(both, 0, 0) - at(both, 0, 1)) / 4
    it = (at(step, 0, 0) + at(step, 0, 1) + at(step, 1, 0) + at(step, 1, 1)) / 4
    return ix, iy, it


def spline_coefficients(image: Array) -> Array:
    """Return the coefficients of the cubic B-spline through all pixels, (H, W).

    Solves (c[i−1] + 4 c[i] + c[i+1])/6 = I[i] along columns and rows, with c mirrored at the
    centres of the border pixels.
    """
    coefficients = np.asarray(image, np.float64)
    for _ in range(2):
        size = coefficients.shape[0]
        if size == 1:  # constant
            coefficients = coefficients.T
            continue
        system = (np.diag(np.full(size, 4.0)) + np.eye(size, k=1) + np.eye(size, k=-1)) / 6
        system[0, 1] = system[-1, -2] = 2 / 6
        coefficients = np.linalg.solve(system, coefficients).T
    return coefficients


def warp(image: Array, flow: Array) -> tuple[Array, Array]:
    """Sample an image at x + flow by its cubic B-spline; the border pixel is repeated outside.

    The image is (H, W), the flow (2, H, W), px/frame. The returned mask, (H, W), is 1 where the
    target lies inside the image.
    """
    height, width = image.shape
    coefficients = np.pad(spline_coefficients(image), 2, mode="reflect")
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    x, y = columns + flow[0], rows + flow[1]
    mask = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    warped = np.zeros((height, width))
    for i in range(-1, 3):
        for j in range(-1, 3):
            weight = _b_spline(x - (left + i)) * _b_spline(y - (top + j))
            warped += weight * coefficients[top + j + 2, left + i + 2]
    return warped, mask.astype(np.float64)


def _b_spline(distance: Array) -> Array:
    """Return the cubic B-spline at a distance in px."""
    d = np.abs(distance)
    near = 2 / 3 - d**2 + d**3 / 2
    far = (2 - d) ** 3 / 6
    return np.where(d <= 1, near, np.where(d < 2, far, 0.0))


def splat(flow: Array, residual: Array) -> Array:
    """Return Σw, Σw·residual, Σw·u, Σw·v, (4, H, W), at every pixel of frame 1.

    w are the bilinear weights of the pixels of frame 0 whose target x + flow lies within 1 px.
    """
    _, height, width = flow.shape
    sums = np.zeros((4, height, width))
    values = np.stack([np.ones_like(residual), residual, *flow])
    for row, column in np.ndindex(height, width):
        x, y = column + flow[0, row, column], row + flow[1, row, column]
        if 0 <= x <= width - 1 and 0 <= y <= height - 1:
            for below, right, weight in _bilinear(x, y, height, width):
                sums[:, below, right] += weight * values[:, row, column]
    return sums


def hidden_pixels(flow: Array, residual: Array, *, density: float, flow_difference: float) -> Array:
    """Return hidden pixels: pixels of another flow and smaller residual have the same target."""
    _, height, width = flow.shape
    sums = splat(flow, residual)
    hidden = np.zeros((height, width), bool)
    for row, column in np.ndindex(height, width):
        x, y = column + flow[0, row, column], row + flow[1, row, column]
        if 0 <= x <= width - 1 and 0 <= y <= height - 1:
            around = _bilinear(x, y, height, width)
            total, *means = np.sum([w * sums[:, j, i] for j, i, w in around], axis=0)
            mean_residual, u, v = np.array(means) / total
            distance = np.hypot(u - flow[0, row, column], v - flow[1, row, column])
            has_larger_residual = residual[row, column] > mean_residual
            hidden[row, column] = (
                total > density and distance > flow_difference and has_larger_residual
            )
    return hidden


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
