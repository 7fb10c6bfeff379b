"""Scale of a moving object: the factor from the unit of its own path to the unit of the world.

Motion alone does not give the scale. A known size gives it, or the contact of the object with the
ground, or, roughly, the depth around the object.
"""

from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.motion.objects.depth import contact_scale
from tisfm.reconstruction.objects.object_path import ObjectPath
from tisfm.reconstruction.result.moving_object import ScaleFrom

# Values without a stated source were set by hand.

# Share of the points that is dropped at both ends of an axis before an extent is measured.
TRIMMED_SHARE = 0.03
# px: width of the ring around an object whose depth may give the distance of the object.
SURROUNDINGS = 15
# Random orientations of a box that are tried for the smallest box.
BOX_TRIALS = 2000
# Points that boxes are fitted to.
MAX_BOX_POINTS = 1000


def find_object_scale(
    path: ObjectPath,
    object_id: int,  # label of the object
    # returns the static inverse depth of a frame, (H, W), 1/unit of the world
    static_depth: Callable[[int], np.ndarray],
    labels_of: Callable[[int], np.ndarray],  # returns the labels of a frame, (H, W)
    # known length of the object, as `longest_side` measures it, in the unit of the world
    size: float | None = None,
) -> tuple[float, ScaleFrom]:
    """Return the scale of an object, and its source."""
    if size is not None:
        length = longest_side(path.points())
        return (size / length, "size") if length > 0 else (1.0, "none")
    contacts, surroundings = [], []
    for depth in path.depths:
        frame = path.frames[depth.frame]
        background, labels = static_depth(frame), labels_of(frame)
        object_pixels = labels == object_id
        valid = object_pixels & np.isfinite(depth.deviation) & (depth.inverse_depth > 0)
        if not valid.any() or not np.isfinite(background).any():
            continue
        combined = np.where(object_pixels, depth.inverse_depth, background).astype(np.float32)
        contact = contact_scale(combined, labels, object_pixels & ~valid, object_id)
        if contact is not None:
            contacts.append(1 / contact)
        window = np.ones((2 * SURROUNDINGS + 1, 2 * SURROUNDINGS + 1), np.uint8)
        ring = (cv2.dilate(np.uint8(object_pixels), window) > 0) & (labels == 0) & (background > 0)
        if ring.any():
            # The object occludes its surroundings, so it is at least as near as their nearest part.
            nearest = np.quantile(background[ring], 0.9)
            surroundings.append(float(np.median(depth.inverse_depth[valid]) / nearest))
    if len(contacts) >= max(2, len(path.depths) / 4):
        return float(np.median(contacts)), "contact"
    if surroundings:
        return float(np.median(surroundings)), "around"
    return 1.0, "none"


def trimmed_extent(points: np.ndarray) -> np.ndarray:
    """Return the extent of points, (N, 3), along each axis, (3,), without the outermost ones."""
    low, high = np.quantile(points, [TRIMMED_SHARE, 1 - TRIMMED_SHARE], axis=0)
    return np.asarray(high - low)


def longest_side(points: np.ndarray) -> float:
    """Return the longest side of the box with the least surface around points, (N, 3).

    It does not depend on the orientation of the points. `trimmed_extent` measures the sides.
    """
    sample = points[:: 1 + len(points) // MAX_BOX_POINTS]
    random = np.random.default_rng(0)
    rotations = Rotation.from_quat(random.normal(size=(BOX_TRIALS, 4))).as_matrix()
    extents = np.stack([trimmed_extent(sample @ rotation) for rotation in rotations])
    areas = (extents * np.roll(extents, 1, axis=1)).sum(axis=1)
    return float(extents[areas.argmin()].max())
