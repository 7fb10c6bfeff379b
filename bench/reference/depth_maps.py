"""Depth maps: rendered into another view, merged, and aligned with the edges of the image."""

import numpy as np

from bench.reference.epipolar import rays
from tisfm.camera import Camera

Array = np.ndarray  # of float64

MAX_RELATIVE_STEP = 0.05  # relative difference of inverse depth between pixels of one surface
MIN_RELATIVE_DEVIATION = 1e-3  # share of inverse depth; smaller deviations count as this
RADIUS = 3  # px: half side of the window whose pixels vote
DISTANCE_WEIGHT = 0.1  # 1/px²: a pixel at a distance d has the weight 1/(1 + 0.1 d²)


def render_depth(
    inverse_depth: Array,  # (H, W) of the first view; 0 is unknown
    deviation: Array,
    rotation: Array,  # (3, 3), from the first view's axes to the other's
    translation: Array,  # (3,)
    camera: Camera,  # of both views
) -> tuple[Array, Array]:
    """Return the inverse depth of another view, and its deviation; 0 if unknown."""
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    ray = rays(camera, height, width)
    target = np.einsum("kl,lhw->khw", rotation, ray)
    target += inverse_depth * translation[:, None, None]
    nearest, central = np.zeros((2, height, width))
    for y, x in zip(*np.nonzero((inverse_depth > 0) & (target[2] > 0)), strict=True):
        projected = inverse_depth[y, x] / target[2, y, x]
        column, row = (target[:2, y, x] / target[2, y, x]) * camera.focal + (cx, cy)
        around = [(np.floor(row) + j, np.floor(column) + i) for j in (0, 1) for i in (0, 1)]
        nearest_pixel = np.floor(row + 0.5), np.floor(column + 0.5)
        for image, positions in ((nearest, around), (central, [nearest_pixel])):
            for down, right in positions:
                if 0 <= down < height and 0 <= right < width:
                    pixel = int(down), int(right)
                    image[pixel] = max(image[pixel], projected)
    out, spread = np.zeros((2, height, width))
    for y, x in np.ndindex(height, width):
        for start, min_weight in ((nearest[y, x], 0.5), (central[y, x], 1e-3)):
            depth, deviation_of_depth = start, 0.0
            for _ in range(2):
                if depth > 0:
                    depth, deviation_of_depth = _sample(
                        inverse_depth,
                        deviation,
                        ray[:, y, x],
                        depth,
                        rotation,
                        translation,
                        camera,
                        min_weight,
                    )
            if depth > 0:
                out[y, x], spread[y, x] = depth, deviation_of_depth
                break
    return out, spread


def _sample(
    inverse_depth: Array,
    deviation: Array,
    ray: Array,
    value: float,
    rotation: Array,
    translation: Array,
    camera: Camera,
    min_weight: float,
) -> tuple[float, float]:
    """Return inverse depth and deviation on a ray of the other view, near `value`.

    They come from the pixels of the first view that show the same surface.
    """
    height, width = inverse_depth.shape
    centre = np.array(camera.center_for(height, width))
    source = rotation.T @ (ray - value * translation)
    if source[2] <= 0:
        return 0.0, 0.0
    column, row = source[:2] / source[2] * camera.focal + centre
    surface_depth, total, depth, spread = value / source[2], 0.0, 0.0, 0.0
    for down in (int(np.floor(row)), int(np.floor(row)) + 1):
        for right in (int(np.floor(column)), int(np.floor(column)) + 1):
            if not (0 <= down < height and 0 <= right < width):
                continue
            pixel_depth = inverse_depth[down, right]
            if (
                pixel_depth > 0
                and abs(pixel_depth - surface_depth) < MAX_RELATIVE_STEP * surface_depth
            ):
                weight = (1 - abs(column - right)) * (1 - abs(row - down))
                total += weight
                depth += weight * pixel_depth
                spread += weight * deviation[down, right]
    if total <= min_weight:
        return 0.0, 0.0
    depth, spread = depth / total, spread / total
    first = np.append((np.array([column, row]) - centre) / camera.focal, 1.0)
    rotated_depth = (rotation @ first)[2]
    target_depth = rotated_depth + depth * translation[2]
    if target_depth <= 0:
        return 0.0, 0.0
    return depth / target_depth, spread * abs(rotated_depth) / target_depth**2


def merge_depths(inverse_depths: Array, deviations: Array, tolerance: float) -> tuple[Array, Array]:
    """Return the means of inverse depth and deviation over the sources that agree most at a pixel.

    The arrays are (N, H, W), for N sources; inverse depth 0 is unknown. Two sources agree if they
    differ by less than the share `tolerance` of the larger inverse depth.
    """
    known = inverse_depths > 0
    floor = np.where(known, MIN_RELATIVE_DEVIATION * inverse_depths, 1)
    votes = np.where(known, inverse_depths / np.maximum(deviations, floor), 0) ** 2
    difference = np.abs(inverse_depths[:, None] - inverse_depths)
    agree = difference < tolerance * np.maximum(inverse_depths[:, None], inverse_depths)
    votes_for_source = votes * (
        agree & known & known[:, None]
    )  # (N, N, H, W): vote of source j for source i
    best = votes_for_source.sum(axis=1).argmax(axis=0)
    best_votes = np.take_along_axis(votes_for_source, best[None, None], axis=0)[0]
    total = np.maximum(best_votes.sum(axis=0), np.finfo(float).tiny)
    depth, deviation = (
        (best_votes * values).sum(axis=0) / total for values in (inverse_depths, deviations)
    )
    return depth, deviation


def align_depth_edges(
    inverse_depth: Array,  # (H, W)
    deviation: Array,
    threshold: Array,  # (H, W), between the two surfaces nearby; 0 if there is only one surface
    frame: Array,
    grey_decay: float,  # grey levels: a pixel that differs by this much from the centre weighs 1/e
) -> tuple[Array, Array]:
    """Return inverse depth and deviation whose edges lie where the frame has edges."""
    depth, spread = inverse_depth.copy(), deviation.copy()
    rows, columns = np.indices(frame.shape)
    for y, x in zip(*np.nonzero(threshold), strict=True):
        square = (rows - y) ** 2 + (columns - x) ** 2
        votes = np.exp(-np.abs(frame - frame[y, x]) / grey_decay) / (1 + DISTANCE_WEIGHT * square)
        votes *= (abs(rows - y) <= RADIUS) & (abs(columns - x) <= RADIUS)
        is_near = inverse_depth[y, x] > threshold[y, x]
        other_votes = votes * ((inverse_depth > threshold[y, x]) != is_near)
        if other_votes.sum() > votes.sum() / 2:
            depth[y, x] = (other_votes * inverse_depth).sum() / other_votes.sum()
            spread[y, x] = (other_votes * deviation).sum() / other_votes.sum()
    return depth, spread
