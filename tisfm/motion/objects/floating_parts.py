"""What floats: parts of a depth map that cannot be at rest, because nothing holds them up.

Things that move along the lines that points at rest move along look like points at rest, nearer
or further than they are. Where they look nearer, they float before everything around them, their
feet included. A thing at rest that stands on the ground is as near as the ground at its base, and
from there the ground comes nearer, down to the border of the image.
"""

import cv2
import numpy as np

PIXELS = 40_000  # of the depth map that is looked at
MEDIAN, BRIDGE = 5, 3  # px of it: windows of a median, and over gaps between a thing and its stand
JOINED = 9  # px of it: parts less than that apart are one
SURE = 2.0  # standard deviations by which something is nearer
NEARER = 1.3  # times: rooms are full of lamps and leaves that hang, but hardly so far before all
GROUND = 0.9  # of the depth around a thing: at least as near is what lies below it at the border
LOWEST = 3  # rows at the border
MOST_PARTS = 255  # parts
FAINTEST_DEPTH = 0.05  # of the median: less inverse depth is as good as none


def floating_parts(inverse_depth: np.ndarray, deviation: np.ndarray, smallest: int) -> np.ndarray:
    """Return the connected parts of a depth map that float, numbered from 1; 0 elsewhere.

    From a point of a thing that stands, a path leads over the thing and the ground to the border
    of the image that is nowhere much further away than the point. The furthest place of the best
    path is what morphological reconstruction by dilation from the border gives: the inverse depth
    with all domes cut off. What is `NEARER` times as near, by lower and upper limits of `SURE`
    deviations, floats, if the image shows the ground below to come nearer, or at least not to
    recede. Things that touch the border never float; those that hang from above, or stand tall
    below a camera that looks straight down on them, seem to.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        In any unit; positive before the camera.
    deviation : (H, W) float32
        Its standard deviation.
    smallest : int
        Fewest pixels of a part.

    Returns
    -------
    (H, W) int32
        Parts in order of size, the largest first.

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
    faintest = FAINTEST_DEPTH * float(np.median(np.abs(depth)))
    highest = np.maximum(depth + margin, faintest)
    around = without_domes(cv2.dilate(highest, np.ones((BRIDGE, BRIDGE), np.uint8)))
    before = (depth - margin > NEARER * around).astype(np.uint8)
    parts = cv2.connectedComponents(cv2.dilate(before, np.ones((JOINED, JOINED), np.uint8)))[1]
    parts *= before
    areas = np.bincount(parts.ravel())
    areas[0] = 0
    floats = np.zeros(parts.shape, np.uint8)
    for part in np.argsort(-areas, kind="stable"):
        mine = parts == part
        if areas[part] < smallest * scale**2 or floats.max() == MOST_PARTS:
            break
        ground = highest[-LOWEST:, mine.any(axis=0)]
        if np.median(ground) >= GROUND * np.median(around[mine]):
            floats[mine] = floats.max() + 1
    return cv2.resize(floats, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.int32)


def without_domes(image: np.ndarray) -> np.ndarray:
    """Return an image with all maxima that do not touch its border cut off.

    At every pixel it is the largest, over paths of eight neighbours to the border, of the least
    value on the path: the reconstruction of the image by dilation from its border.

    Parameters
    ----------
    image : (H, W) float32
    """
    window = np.ones((3, 3), np.uint8)
    reached = np.full_like(image, image.min())
    for border in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        reached[border] = image[border]
    while True:
        further = np.minimum(cv2.dilate(reached, window), image)
        if np.array_equal(further, reached):
            return reached
        reached = further
