"""Scale of a moving object: the factor from the unit of its own path to the unit of the world.

Motion alone does not give the scale. A known size gives it, or the contact of the object with the
ground, or, roughly, the depth around the object.
"""

from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.motion.objects.contacts import contact_scale
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
    own: ObjectPath,
    number: int,  # label of the object
    # returns the static inverse depth of a frame, (H, W), 1/unit of the world
    inverse_depth: Callable[[int], np.ndarray],
    labelled: Callable[[int], np.ndarray],  # returns the labels of a frame, (H, W)
    # known length of the object, as `longest_side` measures it, in the unit of the world
    size: float | None = None,
) -> tuple[float, ScaleFrom]:
    """Return the scale of an object, and its source."""
    if size is not None:
        side = longest_side(own.points())
        return (size / side, "size") if side > 0 else (1.0, "none")
    contacts, around = [], []
    for depth in own.depths:
        frame = own.frames[depth.frame]
        behind, labels = inverse_depth(frame), labelled(frame)
        mine = labels == number
        sure = mine & np.isfinite(depth.deviation) & (depth.inverse_depth > 0)
        if not sure.any() or not np.isfinite(behind).any():
            continue
        both = np.where(mine, depth.inverse_depth, behind).astype(np.float32)
        contact = contact_scale(both, labels, mine & ~sure, number)
        if contact is not None:
            contacts.append(1 / contact)
        window = np.ones((2 * SURROUNDINGS + 1, 2 * SURROUNDINGS + 1), np.uint8)
        ring = (cv2.dilate(np.uint8(mine), window) > 0) & (labels == 0) & (behind > 0)
        if ring.any():
            # The object occludes its surroundings, so it is at least as near as their nearest part.
            nearest = np.quantile(behind[ring], 0.9)
            around.append(float(np.median(depth.inverse_depth[sure]) / nearest))
    if len(contacts) >= max(2, len(own.depths) / 4):
        return float(np.median(contacts)), "contact"
    if around:
        return float(np.median(around)), "around"
    return 1.0, "none"


def reach(points: np.ndarray) -> np.ndarray:
    """Return the extent of points, (N, 3), along each axis, (3,), without the outermost ones."""
    low, high = np.quantile(points, [TRIMMED_SHARE, 1 - TRIMMED_SHARE], axis=0)
    return np.asarray(high - low)


def longest_side(points: np.ndarray) -> float:
    """Return the longest side of the box with the least surface around points, (N, 3).

    It does not depend on the orientation of the points. `reach` measures the sides.
    """
    some = points[:: 1 + len(points) // MAX_BOX_POINTS]
    random = np.random.default_rng(0)
    turns = Rotation.from_quat(random.normal(size=(BOX_TRIALS, 4))).as_matrix()
    sides = np.stack([reach(some @ turn) for turn in turns])
    surface = (sides * np.roll(sides, 1, axis=1)).sum(axis=1)
    return float(sides[surface.argmin()].max())
