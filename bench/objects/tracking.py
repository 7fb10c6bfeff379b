"""Labels over a sequence from the motion masks of its frames."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

LEAST_AREA = 0.002  # of the image: smaller parts are dropped as noise; set by hand
_LAST = 10  # frames after which an unseen label is forgotten; set by hand
_LABELS = 255  # labels, at most, in 8 bits


def as_one(masks: Sequence[NDArray]) -> list[NDArray[np.uint8]]:
    """Return label 1 for all moving pixels."""
    return [(mask > 0).astype(np.uint8) for mask in masks]


def tracked(masks: Sequence[NDArray]) -> list[NDArray[np.uint8]]:
    """Return labels of connected parts, which overlapping parts of later frames inherit.

    Parameters
    ----------
    masks : sequence of (H, W) array
        0 for static pixels; parts with different values are separate.

    Returns
    -------
    list of (H, W) uint8
        A part gets the label that it overlaps most in the last 10 frames, unless a larger part has
        that label. Otherwise it gets a new label, up to 255.
    """
    places: dict[int, NDArray[np.bool_]] = {}
    seen: dict[int, int] = {}
    following = 1
    labels = []
    for number, mask in enumerate(masks):
        label = np.zeros(mask.shape, np.uint8)
        pairs, taken = [], set()
        found = parts(mask)
        for place, part in enumerate(found):
            for known, last in places.items():
                if number - seen[known] <= _LAST and (shared := int((part & last).sum())):
                    pairs.append((shared, place, known))
        names: dict[int, int] = {}
        for _, place, known in sorted(pairs, reverse=True):
            if place not in names and known not in taken:
                names[place] = known
                taken.add(known)
        for place, part in enumerate(found):
            if place not in names:
                if following > _LABELS:
                    continue
                names[place], following = following, following + 1
            name = names[place]
            label[part] = name
            places[name], seen[name] = part, number
        labels.append(label)
    return labels


def parts(mask: NDArray) -> list[NDArray[np.bool_]]:
    """Return the connected parts of each value that are large enough, the largest first."""
    found = []
    for value in np.unique(mask[mask > 0]):
        _, components = cv2.connectedComponents((mask == value).astype(np.uint8))
        areas = np.bincount(components.ravel())
        areas[0] = 0
        found += [
            (int(areas[k]), components == k)
            for k in np.flatnonzero(areas >= LEAST_AREA * mask.size)
        ]
    return [part for _, part in sorted(found, key=lambda item: -item[0])]
