"""Comparison and volumetric fusion of depth maps: the reference of `tisfm.fusion`."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAX_RELATIVE_STEP = 0.05  # relative step of inverse depth between neighbours on one surface
MIN_DEPTH_RATIO = 0.05  # minimum depth in another view over the depth in this view
MIN_SIMILAR_NEIGHBOURS = 3  # of eight: a pixel with fewer neighbours of similar depth is an error
MAX_INTERPOLATION_DISTANCE = 2.0  # truncations from the depth of the nearest pixel


def inverse_depth_at(image: Floats, x: float, y: float) -> float:
    """Return inverse depth at a position, interpolated if its four pixels show one surface."""
    pixel_value = float(image[_nearest(x, y)])
    left, top = int(np.floor(x)), int(np.floor(y))
    across, down = x - left, y - top
    rows = np.clip([top, top + 1], 0, image.shape[0] - 1)
    columns = np.clip([left, left + 1], 0, image.shape[1] - 1)
    around = image[np.ix_(rows, columns)]
    if pixel_value <= 0 or around.min() <= 0 or np.ptp(around) >= MAX_RELATIVE_STEP * around.max():
        return pixel_value
    return float(np.array([1 - down, down]) @ around @ np.array([1 - across, across]))


def compare(
    inverse_depth: Floats,
    deviation: Floats,
    other_inverse_depth: Floats,
    other_deviation: Floats,
    other_colors: Floats,
    *,
    projection: Floats,
    tolerance: float,
    max_difference: float,
) -> tuple[Floats, Floats]:
    """Return the contributions of another view to the sums, (H, W, 5), and colours, (H, W, 3)."""
    sums = np.zeros((*inverse_depth.shape, 5))
    colors = np.zeros((*inverse_depth.shape, 3))
    for (y, x), d in np.ndenumerate(inverse_depth):
        rotated_depth = projection[2, :3] @ (x, y, 1)
        u, v, g = projection @ (x, y, 1, d)
        if (
            d <= 0
            or min(g, rotated_depth) <= MIN_DEPTH_RATIO
            or not _inside(u / g, v / g, other_inverse_depth)
        ):
            continue
        other_depth = inverse_depth_at(other_inverse_depth, u / g, v / g)
        if other_depth <= 0:
            continue
        pixel = _nearest(u / g, v / g)
        slope = rotated_depth / g**2
        difference = other_depth - d / g
        limit = tolerance * np.hypot(slope * deviation[y, x], other_deviation[pixel])
        sums[y, x, 4] = 1
        if difference < -limit:
            sums[y, x, 3] = 1
        elif abs(difference) <= min(limit, max_difference * d / g):
            precision = (slope / other_deviation[pixel]) ** 2
            sums[y, x, :3] = precision, precision * difference / slope, 1
            colors[y, x] = other_colors[pixel]
    return sums, colors


def measure_differences(
    inverse_depth: Floats,
    deviation: Floats,
    other_inverse_depth: Floats,
    other_deviation: Floats,
    *,
    projection: Floats,
) -> Floats:
    """Return the difference of another view, as a share and in deviations, (H, W, 2); or NaN."""
    differences = np.full((*inverse_depth.shape, 2), np.nan)
    for (y, x), d in np.ndenumerate(inverse_depth):
        rotated_depth = projection[2, :3] @ (x, y, 1)
        u, v, g = projection @ (x, y, 1, d)
        if (
            d <= 0
            or min(g, rotated_depth) <= MIN_DEPTH_RATIO
            or not _inside(u / g, v / g, other_inverse_depth)
        ):
            continue
        other_depth = inverse_depth_at(other_inverse_depth, u / g, v / g)
        if other_depth <= 0:
            continue
        own_deviation = rotated_depth / g**2 * deviation[y, x]
        combined = np.hypot(own_deviation, other_deviation[_nearest(u / g, v / g)])
        difference = abs(other_depth - d / g)
        differences[y, x] = difference * g / d, difference / combined
    return differences


def count_views(
    points: Floats,
    relative_deviation: Floats,
    inverse_depth: Floats,
    deviation: Floats,
    *,
    projection: Floats,
    tolerance: float,
    min_difference: float,
) -> np.ndarray:
    """Return whether a view shows points, and whether it sees through them, (N, 2) int."""
    counts = np.zeros((len(points), 2), int)
    for n, point in enumerate(points):
        u, v, z = projection @ np.append(point, 1)
        if z <= 0 or not _inside(u / z, v / z, inverse_depth):
            continue
        pixel = _nearest(u / z, v / z)
        if inverse_depth[pixel] <= 0:
            continue
        spread = np.hypot(relative_deviation[n] / z, deviation[pixel])
        limit = max(tolerance * spread, min_difference / z)
        difference = inverse_depth[pixel] - 1 / z
        counts[n] = abs(difference) <= limit, difference < -limit
    return counts


def mark_visible_pixels(
    points: Floats,
    relative_deviation: Floats,
    inverse_depth: Floats,
    deviation: Floats,
    *,
    projection: Floats,
    tolerance: float,
) -> np.ndarray:
    """Return the pixels that show one of the points, (H, W) bool."""
    height, width = inverse_depth.shape
    is_visible = np.zeros((height, width), bool)
    for point, relative in zip(points, relative_deviation, strict=True):
        u, v, z = projection @ np.append(point, 1)
        if z <= 0 or not _inside(u / z, v / z, inverse_depth):
            continue
        for row in (int(np.floor(v / z)), int(np.floor(v / z)) + 1):
            for column in (int(np.floor(u / z)), int(np.floor(u / z)) + 1):
                if 0 <= row < height and 0 <= column < width:
                    limit = tolerance * np.hypot(relative / z, deviation[row, column])
                    difference = abs(inverse_depth[row, column] - 1 / z)
                    is_visible[row, column] |= (
                        inverse_depth[row, column] > 0 and difference <= limit
                    )
    return is_visible


def blocks_near(
    inverse_depth: Floats,
    deviation: Floats,
    *,
    stride: int,
    rays: Floats,
    truncation: float,
    samples: int,
) -> set[tuple[int, int, int]]:
    """Return the positions, in blocks, of the blocks of 8³ voxels near the surface of a view."""
    blocks = set()
    for y in range(0, inverse_depth.shape[0], stride):
        for x in range(0, inverse_depth.shape[1], stride):
            d = inverse_depth[y, x]
            around = inverse_depth[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            similar = np.abs(around - d) < max(MAX_RELATIVE_STEP * d, 3 * deviation[y, x])
            if d <= 0 or np.count_nonzero(similar) - 1 < MIN_SIMILAR_NEIGHBOURS:
                continue
            for depth in 1 / d + truncation * np.linspace(-1, 1, samples):
                point = rays[:, :3] @ (x, y, 1) * depth + rays[:, 3]
                for corner in np.ndindex(2, 2, 2) if depth > 0 else ():
                    block = np.floor((point + 2 * np.array(corner) - 1) / 8).astype(int)
                    blocks.add((int(block[0]), int(block[1]), int(block[2])))
    return blocks


def integrate(
    inverse_depth: Floats,
    deviation: Floats,
    corners: Floats,
    *,
    steps: Floats,
    truncation: float,
    spread: float,
) -> tuple[Floats, Floats, np.ndarray]:
    """Return the signed distances and weights that a view gives to the voxels of some blocks.

    All are (B, 512). Distances to the surface are in truncations, at most 1. Weights are 0 outside
    the view, without depth, or too far behind the surface. The third array, bool, has the voxels
    within the truncation of the surface.
    """
    distance, weight = np.zeros((len(corners), 512)), np.zeros((len(corners), 512))
    near = np.zeros((len(corners), 512), bool)
    for b, voxel in np.ndindex(len(corners), 512):
        u, v, z = corners[b] + np.unravel_index(voxel, (8, 8, 8)) @ steps
        if z <= 0 or not _inside(u / z, v / z, inverse_depth):
            continue
        pixel = _nearest(u / z, v / z)
        d = inverse_depth[pixel]
        if d > 0 and abs(1 / d - z) <= MAX_INTERPOLATION_DISTANCE * truncation:
            d = inverse_depth_at(inverse_depth, u / z, v / z)
        if d > 0 and 1 / d - z >= -truncation:
            depth_deviation = deviation[pixel] / d**2
            distance[b, voxel] = min((1 / d - z) / truncation, 1)
            weight[b, voxel] = spread**2 / (depth_deviation**2 + spread**2)
            near[b, voxel] = 1 / d - z <= truncation
    return distance, weight, near


def add_colors(
    points: Floats, inverse_depth: Floats, colors: Floats, *, projection: Floats, near: float
) -> Floats:
    """Return the contributions of a view to the colours of points and their weights, (N, 4)."""
    sums = np.zeros((len(points), 4))
    for n, point in enumerate(points):
        u, v, z = projection @ np.append(point, 1)
        if z > 0 and _inside(u / z, v / z, inverse_depth):
            d = inverse_depth_at(inverse_depth, u / z, v / z)
            if d > 0 and abs(1 / d - z) <= near:
                sums[n] = np.append(colors[_nearest(u / z, v / z)], 1) / z**2
    return sums


def _inside(x: float, y: float, image: np.ndarray) -> bool:
    height, width = image.shape
    return bool(-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5)


def _nearest(x: float, y: float) -> tuple[int, int]:
    """Return row and column of the pixel at a position."""
    return int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
