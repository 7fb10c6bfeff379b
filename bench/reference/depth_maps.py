"""Depth maps: rendered into another view, merged, and aligned with the edges of the image."""

import numpy as np

from bench.reference.epipolar import rays
from tisfm.camera import Camera

Array = np.ndarray  # of float64

MAX_RELATIVE_STEP = 0.05  # relative difference of inverse depth between pixels of one surface
MIN_SURFACE_WEIGHT = 1e-3  # least weight of the four pixels around a position
MAX_STRETCH = 256  # px: the largest extent of a triangle that is drawn
MIN_AREA = 1e-6  # px²: twice the area of the smallest triangle that is drawn
MIN_RELATIVE_DEVIATION = 1e-3  # share of inverse depth; smaller deviations count as this
MIN_LIKENESS = 0.05  # least factor of a vote whose grey levels differ
MIN_BORDER_SHARE = 0.05  # least factor of a mean at the border of a keyframe
RADIUS = 3  # px: half side of the window whose pixels vote
DISTANCE_WEIGHT = 0.1  # 1/px²: a pixel at a distance d has the weight 1/(1 + 0.1 d²)


def render_depth(
    inverse_depth: Array,  # (H, W) of the first view; 0 is unknown
    deviation: Array,
    rotation: Array,  # (3, 3), from the first view's axes to the other's
    translation: Array,  # (3,)
    camera: Camera,  # of both views
    continued_deviation: float = 0.0,  # share of inverse depth; 0: surfaces end at jumps
) -> tuple[Array, Array]:
    """Return the inverse depth of another view, and its deviation; 0 if unknown."""
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    ray = rays(camera, height, width)
    target = np.einsum("kl,lhw->khw", rotation, ray)
    target += inverse_depth * translation[:, None, None]
    is_ahead = (inverse_depth > 0) & (target[2] > 0)
    z = np.where(is_ahead, target[2], 1)
    x, y = target[0] / z * camera.focal + cx, target[1] / z * camera.focal + cy
    points = np.stack([x, y, np.where(is_ahead, inverse_depth / z, 0)])
    nearest, continued = np.zeros((2, height, width))
    for row, column in zip(*np.nonzero(is_ahead), strict=True):
        x, y, value = points[:, row, column]
        down, right = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
        if 0 <= down < height and 0 <= right < width:
            nearest[down, right] = max(nearest[down, right], value)
    for row, column in np.ndindex(height - 1, width - 1):
        square = np.s_[row : row + 2, column : column + 2]
        corners = points[:, row : row + 2, column : column + 2].copy()
        if not is_ahead[square].all():
            continue
        is_surface = _is_surface(inverse_depth[square])
        if not is_surface:
            corners[2] = corners[2].min()
        if is_surface or continued_deviation > 0:
            image = nearest if is_surface else continued
            _draw_triangle(image, corners[:, 0, 0], corners[:, 0, 1], corners[:, 1, 1])
            _draw_triangle(image, corners[:, 0, 0], corners[:, 1, 1], corners[:, 1, 0])
    out, spread = continued, continued_deviation * continued
    motion = rotation, translation
    for row, column in zip(*np.nonzero(nearest), strict=True):
        depth, its_deviation = _sample(
            inverse_depth, deviation, ray[:, row, column], nearest[row, column], *motion, camera
        )
        if depth > 0:
            out[row, column], spread[row, column] = depth, its_deviation
    return out, spread


def _is_surface(square: Array) -> bool:
    """Return whether neighbours among the four pixels of a square show one surface."""
    limit = MAX_RELATIVE_STEP
    return all(
        abs(first - second) < limit * max(first, second)
        for first, second in zip(
            (square[0, 0], square[1, 0], square[0, 0], square[0, 1]),
            (square[0, 1], square[1, 1], square[1, 0], square[1, 1]),
            strict=True,
        )
    )


def _draw_triangle(image: Array, *corners: Array) -> None:
    """Keep the largest inverse depth at the pixels in a triangle; corners are x, y and value."""
    (x0, y0, _), (x1, y1, _), (x2, y2, _) = corners
    extent = max(np.ptp([x0, x1, x2]), np.ptp([y0, y1, y2]))
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    if abs(area) <= MIN_AREA or extent >= MAX_STRETCH:
        return
    matrix = np.vstack([np.array(corners)[:, :2].T, np.ones(3)])
    for row in range(max(0, int(min(y0, y1, y2))), min(image.shape[0], int(max(y0, y1, y2)) + 2)):
        left, right = max(0, int(min(x0, x1, x2))), int(max(x0, x1, x2)) + 2
        for column in range(left, min(image.shape[1], right)):
            shares = np.linalg.solve(matrix, (column, row, 1.0))
            if shares.min() >= -1e-9:
                value = shares @ [corner[2] for corner in corners]
                image[row, column] = max(image[row, column], value)


def _sample(
    inverse_depth: Array,
    deviation: Array,
    ray: Array,
    value: float,
    rotation: Array,
    translation: Array,
    camera: Camera,
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
    if total <= MIN_SURFACE_WEIGHT:
        return 0.0, 0.0
    depth, spread = depth / total, spread / total
    first = np.append((np.array([column, row]) - centre) / camera.focal, 1.0)
    rotated_depth = (rotation @ first)[2]
    target_depth = rotated_depth + depth * translation[2]
    if target_depth <= 0:
        return 0.0, 0.0
    return depth / target_depth, spread * abs(rotated_depth) / target_depth**2


def merge_depths(
    inverse_depths: Array,  # (N, H, W): candidates of N keyframes in the frame; 0 is unknown
    deviations: Array,
    frame: Array,  # (H, W): grey levels
    key_depths: Array,  # (N, H, W): the keyframes themselves
    key_deviations: Array,
    key_frames: Array,
    motions: Array,  # (N, 3, 4), from the frame to each keyframe
    camera: Camera,
    *,
    tolerance: float,
    grey_decay: float,
    border: float,
) -> tuple[Array, Array]:
    """Return the means of inverse depth and deviation over the candidates of one surface.

    Two candidates agree if they differ by less than the share `tolerance` of the larger one. The
    surface is the nearest candidate with more votes for it than against it, or else the candidate
    with most votes.
    """
    count, height, width = inverse_depths.shape
    out, spread = np.zeros((2, height, width))
    ray = rays(camera, height, width)
    for y, x in np.ndindex(height, width):
        candidates = inverse_depths[:, y, x]
        known = np.flatnonzero(candidates > 0)
        if not len(known):
            continue
        weights, shares, votes = np.zeros((3, count))
        for k in known:
            position = _project(motions[k], ray[:, y, x], candidates[k], camera, frame.shape)
            likeness, shares[k] = _likeness(
                key_frames[k], position, frame[y, x], grey_decay, border
            )
            weights[k] = _precision(candidates[k], deviations[k, y, x]) * likeness
        difference = np.abs(candidates[:, None] - candidates)
        agree = difference < tolerance * np.maximum(candidates[:, None], candidates)
        agree &= (candidates > 0) & (candidates[:, None] > 0)
        for k in known:
            votes[k] = weights[agree[k]].sum()
            for other in np.flatnonzero(~agree[k]):
                position = _project(
                    motions[other], ray[:, y, x], candidates[k], camera, frame.shape
                )
                against = _free_space(key_depths[other], key_deviations[other], position, tolerance)
                is_behind = 0 < candidates[other] < candidates[k]
                votes[k] -= min(against, weights[other]) if is_behind else against
        best = known[0]
        for k in known[1:]:
            is_better = votes[k] > votes[best]
            if not agree[k, best] and votes[k] > 0 and votes[best] > 0:
                is_better = candidates[k] > candidates[best]
            best = k if is_better else best
        chosen = weights * shares * agree[best]
        out[y, x] = (chosen * candidates).sum() / chosen.sum()
        spread[y, x] = (chosen * deviations[:, y, x]).sum() / chosen.sum()
    return out, spread


def _project(
    motion: Array, ray: Array, depth: float, camera: Camera, shape: tuple[int, int]
) -> tuple[float, float, float]:
    """Return x, y and inverse depth of a point in a keyframe; far outside if it is behind it."""
    point = motion[:, :3] @ ray + depth * motion[:, 3]
    if point[2] <= 0:
        return -1e6, -1e6, 0.0
    x, y = point[:2] / point[2] * camera.focal + camera.center_for(*shape)
    return x, y, depth / point[2]


def _precision(depth: float, deviation: float) -> float:
    return float((depth / max(deviation, MIN_RELATIVE_DEVIATION * depth)) ** 2)


def _likeness(
    image: Array, position: tuple[float, float, float], grey: float, decay: float, border: float
) -> tuple[float, float]:
    """Return the likeness of grey levels, and the factor of a mean near the border."""
    height, width = image.shape
    x, y = np.clip(position[0], 0, width - 1), np.clip(position[1], 0, height - 1)
    left, top = int(x), int(y)
    right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
    upper = (1 - x + left) * image[top, left] + (x - left) * image[top, right]
    lower = (1 - x + left) * image[bottom, left] + (x - left) * image[bottom, right]
    shown = (1 - y + top) * upper + (y - top) * lower
    distance = min(x, y, width - 1 - x, height - 1 - y)
    return (
        max(np.exp(-abs(shown - grey) / decay), MIN_LIKENESS),
        min(max(distance / border, MIN_BORDER_SHARE), 1.0),
    )


def _free_space(
    depth: Array, deviation: Array, position: tuple[float, float, float], tolerance: float
) -> float:
    """Return the weight of a keyframe that looks through a point; else 0."""
    x, y, point_depth = position
    height, width = depth.shape
    if not (-0.5 < x < width - 0.5 and -0.5 < y < height - 0.5):
        return 0.0
    column, row = int(np.floor(x)), int(np.floor(y))
    square = np.s_[max(row, 0) : row + 2, max(column, 0) : column + 2]
    index = np.argmax(depth[square])
    surface = depth[square].flat[index]
    if not 0 < surface < (1 - tolerance) * point_depth:
        return 0.0
    return _precision(surface, deviation[square].flat[index])


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
