"""PatchMatch: costs of planes, the search for better planes, and the consistency of two frames."""

from collections.abc import Callable

import numpy as np

from bench.reference.epipolar import rays
from tisfm.camera import Camera

Array = np.ndarray  # of float64

RADIUS = 5  # px, of the windows
SIMILARITY_SCALE = 20.0  # grey levels, scale of the weights of a window's pixels
SKIPPED_COST = 4.0  # cost of a pixel that is not compared
MISSING_PLANE = -1e30  # D of a missing plane
OUTSIDE_COST = 1.0  # cost of a plane that moves the pixel out of the frame
MIN_CHANGE = 0.03  # px: a plane closer than this to the current one is not tried
DISTANCES = (1, 3, 5, 7, 13, 21)  # px, to neighbours
_EAST, _SOUTH = np.eye(3)[:2, :, None, None]


def window_cost(
    levels0: Array,  # (H, W), grey levels
    levels1: Array,
    target: Array,  # (3, H, W), column and row of each pixel in frame 1, px, homogeneous
    east: Array,  # (3, H, W) or (3, 1, 1), change of `target` to the eastern neighbour
    south: Array,  # the same, to the southern neighbour
    *,
    noise: float,  # added to the variance of both windows
) -> tuple[Array, Array]:
    """Return 1 − c at every pixel: c is the weighted correlation of its window and the warped one.

    The window has every second pixel of 11×11, without corners; beyond both images their borders
    repeat. A pixel that differs from the centre by n·`SIMILARITY_SCALE` levels weighs
    1/(1 + n + n²/2 + n³/6).

    The cost, (H, W), is 1 if the pixel leaves frame 1. The second array is the variance of the
    window of frame 0, (H, W).
    """
    height, width = levels0.shape
    padded = np.pad(levels0, RADIUS, "edge")
    total, sums = 0.0, np.zeros((5, height, width))
    offsets = range(-RADIUS, RADIUS + 1, 2)
    for down, across in ((j, i) for j in offsets for i in offsets if abs(i * j) < RADIUS**2):
        window = padded[RADIUS + down :, RADIUS + across :][:height, :width]
        grey0 = window - levels0
        n = np.abs(grey0) / SIMILARITY_SCALE
        weight = 1 / (1 + n * (1 + n * (1 / 2 + n / 6)))
        x, y, z = target + across * east + down * south
        grey1 = bilinear(levels1, y / z, x / z) - levels0
        total = total + weight
        sums += weight * np.stack([grey0, grey1, grey0**2, grey1**2, grey0 * grey1])
    mean0, mean1, square0, square1, product = sums / total
    variance0, variance1 = square0 - mean0**2, square1 - mean1**2
    correlation = (product - mean0 * mean1) / np.sqrt((variance0 + noise) * (variance1 + noise))
    u, v = target[:2] / target[2]
    return np.where(_inside(u, v), 1 - correlation, OUTSIDE_COST), variance0


def plane_cost(
    levels0: Array,  # (H, W), grey levels
    levels1: Array,
    planes: Array,  # (3, H, W), D, px/frame, and its slopes
    camera: Camera,
    rotation: Array,  # (3, 3)
    translation: Array,  # (3,)
    *,
    noise: float,  # of `window_cost`
) -> tuple[Array, Array]:
    """Return `window_cost` of a plane at every pixel, and the variance of its window."""
    cx, cy = camera.center_for(*levels0.shape)
    rows, columns = np.indices(levels0.shape)
    ray_vectors = np.stack([columns - cx, rows - cy, np.full(levels0.shape, camera.focal)])
    to_pixels = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    rotated, shift = to_pixels @ rotation, to_pixels @ translation
    target, east, south = (
        np.einsum("ij,jyx->iyx", rotated, ray) + np.multiply.outer(shift, change)
        for ray, change in zip((ray_vectors, _EAST, _SOUTH), planes, strict=True)
    )
    return window_cost(levels0, levels1, target, east, south, noise=noise)


def best_mean(costs: Array, best: int, *, missing_cost: float) -> Array:
    """Return the mean of the `best` lowest costs of several frames, (M, …).

    If fewer frames show a hypothesis, the missing costs are `missing_cost`; if none shows
    it, they are 1.
    """
    is_visible = costs != OUTSIDE_COST
    some = np.where(is_visible.any(axis=0), missing_cost, OUTSIDE_COST)
    lowest = np.sort(np.where(is_visible, costs, np.inf), axis=0)[:best]
    mean: Array = np.where(np.isfinite(lowest), lowest, some).mean(axis=0)
    return mean


def improve_planes(
    # (4, H, W): D, px/frame, its slopes, and the cost. A pixel with `SKIPPED_COST` does not change.
    state: Array,
    cost: Callable[[Array], Array],  # takes planes (3, H, W), returns their cost (H, W)
    *,
    color: int,  # 0 for red, 1 for black
    draws: int,
    spread: float,  # range of the first random change of D and of the slopes
    tilt: float,
    max_slope: float,  # range of the slopes of a random plane, as a share of D
    bounds: tuple[float, float],  # range of D
    seed: int,
) -> Array:
    """Return the planes after an update of the pixels of one colour.

    Each compares its plane with the cheapest of its neighbours on each of four sides, with a random
    plane, and with `draws` random changes of the best plane, whose range halves each time.
    """
    rows, columns = np.indices(state.shape[1:])
    number = 4 * (rows * state.shape[2] + columns) * (draws + 1)
    random = _hash(number.astype(np.uint32) + _hash(np.array([seed], np.uint32)))
    is_updated = ((rows + columns) % 2 == color) & (state[3] < SKIPPED_COST)
    best = state.copy()
    for turn in range(5 + draws):
        plane = best[:3]
        if turn < 4:
            plane = _neighbours(state, *((1, 0), (-1, 0), (0, 1), (0, -1))[turn])
        else:
            random_units = np.stack([_hash(random + np.uint32(k)) >> 8 for k in range(3)]) / 2**24
            random = random + np.uint32(4)
            if turn == 4:
                depth = bounds[0] + (bounds[1] - bounds[0]) * random_units[0]
                plane = np.stack([depth, *(max_slope * depth.clip(0) * (2 * random_units[1:] - 1))])
            else:
                ranges = np.array([spread, tilt, tilt])[:, None, None] / 2 ** (turn - 5)
                plane = plane + ranges * (2 * random_units - 1)
        change = np.abs(plane - best[:3])
        is_tried = is_updated & (plane[0] > bounds[0]) & (plane[0] < bounds[1])
        is_tried &= change[0] + RADIUS * (change[1] + change[2]) > MIN_CHANGE
        candidate = np.concatenate([plane, cost(plane)[None]])
        best = np.where(is_tried & (candidate[3] < best[3]), candidate, best)
    return best


def _neighbours(state: Array, down: int, across: int) -> Array:
    """Return the cheapest plane on one side, extended to each pixel; else `MISSING_PLANE`."""
    _, height, width = state.shape
    rows, columns = np.indices((height, width))
    best = np.zeros_like(state)
    best[0], best[3] = MISSING_PLANE, SKIPPED_COST
    for distance in DISTANCES:
        row, column = rows + distance * down, columns + distance * across
        is_inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        neighbour = state[:, row.clip(0, height - 1), column.clip(0, width - 1)]
        neighbour[0] -= distance * (across * neighbour[1] + down * neighbour[2])
        best = np.where(is_inside & (neighbour[3] < best[3]), neighbour, best)
    return best[:3]


def _hash(value: Array) -> Array:
    """Return a hash of each value, uint32 (Jarzynski, Olano, JCGT 2020: PCG)."""
    state = value * np.uint32(747796405) + np.uint32(2891336453)
    word = ((state >> ((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint32(277803737)
    mixed: Array = (word >> np.uint32(22)) ^ word
    return mixed


def plane_disagreement(
    planes0: Array,  # (3, H, W): D, px/frame, and its slopes
    planes1: Array,  # the same; D is infinite where it is unknown
    camera: Camera,
    rotation: Array,  # (3, 3), from frame 0 to frame 1
    translation: Array,  # (3,)
) -> Array:
    """Return |D of frame 0, seen from frame 1 − D of the plane of the nearest pixel of frame 1|.

    It is (H, W), px/frame; infinite where the pixel leaves the image or D of frame 1 is unknown.
    """
    height, width = planes0.shape[1:]
    cx, cy = camera.center_for(height, width)
    points = np.einsum("ij,jyx->iyx", rotation, rays(camera, height, width))
    points += translation[:, None, None] * planes0[0] / camera.focal
    u, v = cx + camera.focal * points[0] / points[2], cy + camera.focal * points[1] / points[2]
    column, row = np.floor(u + 0.5).astype(int), np.floor(v + 0.5).astype(int)
    depth, east, south = planes1[:, row.clip(0, height - 1), column.clip(0, width - 1)]
    back = depth + east * (u - column) + south * (v - row)
    return np.where(_inside(u, v), np.abs(back - planes0[0] / points[2]), np.inf)


def _inside(u: Array, v: Array) -> Array:
    """Return the positions, (H, W), that are inside an image of this size."""
    height, width = u.shape
    is_inside: Array = (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    return is_inside


def bilinear(image: Array, rows: Array, columns: Array) -> Array:
    height, width = image.shape
    rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
    top, left = np.floor(rows).astype(int), np.floor(columns).astype(int)
    bottom, right = np.minimum(top + 1, height - 1), np.minimum(left + 1, width - 1)
    b, a = rows - top, columns - left
    above = (1 - a) * image[top, left] + a * image[top, right]
    below = (1 - a) * image[bottom, left] + a * image[bottom, right]
    return (1 - b) * above + b * below
