"""Which views a view is compared with."""

import math
from collections.abc import Sequence

import numpy as np

from tisfm.fusion.views import Seen

# Of the sum of angles, in fields of view and rad, and of the logarithm of the ratio of distances:
NEAR = 0.7  # much is seen by both
FARTHEST = 1.5  # hardly anything is


def neighbours(n: int, seen: Sequence[Seen], count: int) -> list[int]:
    """Return other views that see much of what a view sees, from the nearest to the farthest.

    They are judged by the point in the middle of what the view sees: how far from their axis they
    see it, in their field of view, how much their direction to it differs, and their distance. Of
    the views that are near in this, `count` are taken from the nearest to the farthest: neighbours
    in time alone may show the same mistakes. Where there are fewer, others follow.

    Parameters
    ----------
    n : int
        The view.
    seen : sequence of Seen
        All views.
    count : int
        How many are taken at most.
    """
    mine = seen[n]
    middle = mine.pose[:3, 3] + mine.depth * mine.pose[:3, 2]
    apart = np.array([_apart(middle, mine, other) for other in seen])
    apart[n] = math.inf
    order = np.argsort(apart, kind="stable")
    usable = min(count, np.count_nonzero(apart <= FARTHEST))
    near = order[: max(usable, np.count_nonzero(apart <= NEAR))]
    chosen = np.linspace(0, len(near) - 1, min(count, len(near))).round().astype(int)
    return [int(near[k]) for k in chosen]


def _apart(middle: np.ndarray, mine: Seen, other: Seen) -> float:
    """Return how differently another view sees a point in the middle of a view."""
    ray = middle - other.pose[:3, 3]
    distance = float(np.linalg.norm(ray))
    if distance <= 0:
        return math.inf
    ray /= distance
    from_axis = math.acos(np.clip(ray @ other.pose[:3, 2], -1, 1)) / other.field
    parallax = math.acos(np.clip(ray @ mine.pose[:3, 2], -1, 1))
    return from_axis + parallax + abs(math.log(distance / mine.depth))
