"""Floating parts: regions of a depth map that cannot be at rest, because nothing supports them.

An object that moves along the epipolar lines of points at rest looks like a point at rest with a
wrong depth. If it looks nearer, the whole object, with its feet, floats before its surroundings.
An object at rest on the ground is different: it has the depth of the ground at its base, and from
there the ground comes nearer, down to the border of the image.
"""

import cv2
import numpy as np

PIXELS = 40_000  # most pixels of the depth map, which is reduced if it has more
MEDIAN, BRIDGE = 5, 3  # px of that map: windows of a median, and across gaps below an object
JOINED = 9  # px of that map: window that joins parts
SURE = 2.0  # standard deviations between inverse depth and its upper and lower limits
# Least inverse depth of a part relative to that around it; hanging lamps and leaves have less.
NEARER = 1.3
GROUND = 0.9  # least inverse depth at the border below a part, relative to that around the part
LOWEST = 3  # rows at the lower border that are taken for the ground
MOST_PARTS = 255  # parts
FAINTEST_DEPTH = 0.05  # of the median: least inverse depth of the surroundings


def floating_parts(
    inverse_depth: np.ndarray,  # (H, W) float32: in any unit; positive before the camera
    deviation: np.ndarray,  # (H, W) float32: its standard deviation
    min_size: int,  # fewest pixels of a part
) -> np.ndarray:  # (H, W) int32: parts in order of size, the largest first
    """Return the connected parts of a depth map that float, numbered from 1; 0 elsewhere.

    From each point of a standing object, a path over the object and the ground leads to the border
    of the image, and no point of the path is much farther away than the first. Morphological
    reconstruction by dilation from the border gives the farthest point of the best path: it is the
    inverse depth with all domes cut off. A part floats if its inverse depth is `NEARER` times as
    large, by lower and upper limits of `SURE` deviations, and if the ground below it comes nearer
    or at least does not recede. Objects that touch the border never float. Objects that hang from
    above, or are tall and seen from straight above, wrongly seem to float.

    References
    ----------
    Vincent, "Morphological grayscale reconstruction in image analysis", IEEE Transactions on
    Image Processing 2 (1993) 176, doi 10.1109/83.217222.
    """
    height, width = inverse_depth.shape
    scale = min(1.0, (PIXELS / (height * width)) ** 0.5)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    depth, margin = (
        cv2.medianBlur(cv2.resize(image, size, interpolation=cv2.INTER_AREA), MEDIAN)
        for image in (inverse_depth.astype(np.float32), SURE * deviation.astype(np.float32))
    )
    min_depth = FAINTEST_DEPTH * float(np.median(np.abs(depth)))
    upper_limit = np.maximum(depth + margin, min_depth)
    surroundings = without_domes(cv2.dilate(upper_limit, np.ones((BRIDGE, BRIDGE), np.uint8)))
    is_in_front = (depth - margin > NEARER * surroundings).astype(np.uint8)
    parts = cv2.connectedComponents(cv2.dilate(is_in_front, np.ones((JOINED, JOINED), np.uint8)))[1]
    parts *= is_in_front
    areas = np.bincount(parts.ravel())
    areas[0] = 0
    floating = np.zeros(parts.shape, np.uint8)
    for part in np.argsort(-areas, kind="stable"):
        is_part = parts == part
        if areas[part] < min_size * scale**2 or floating.max() == MOST_PARTS:
            break
        ground = upper_limit[-LOWEST:, is_part.any(axis=0)]
        if np.median(ground) >= GROUND * np.median(surroundings[is_part]):
            floating[is_part] = floating.max() + 1
    return cv2.resize(floating, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.int32)


def without_domes(
    image: np.ndarray,  # (H, W) float32
) -> np.ndarray:
    """Return an image with all maxima that do not touch its border cut off.

    Each pixel takes the largest, over all 8-connected paths to the border, of the least value on
    the path. This is the morphological reconstruction of the image by dilation from its border.
    """
    window = np.ones((3, 3), np.uint8)
    result = np.full_like(image, image.min())
    for border in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        result[border] = image[border]
    while True:
        expanded = np.minimum(cv2.dilate(result, window), image)
        if np.array_equal(expanded, result):
            return result
        result = expanded
