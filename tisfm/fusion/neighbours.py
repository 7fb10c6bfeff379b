"""Which views a view is compared with."""

import math
from collections.abc import Sequence

import numpy as np

from tisfm.checks import Floats
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
    apart = _apart(seen[n], seen)
    apart[n] = math.inf
    order = np.argsort(apart, kind="stable")
    usable = min(count, np.count_nonzero(apart <= FARTHEST))
    near = order[: max(usable, np.count_nonzero(apart <= NEAR))]
    chosen = np.linspace(0, len(near) - 1, min(count, len(near))).round().astype(int)
    return [int(near[k]) for k in chosen]


def _apart(mine: Seen, seen: Sequence[Seen]) -> Floats:
    """Return how differently each view sees the point in the middle of a view, (N,)."""
    axis = mine.pose[:3, 2]
    poses = np.array([other.pose for other in seen])
    rays = mine.pose[:3, 3] + mine.depth * axis - poses[:, :3, 3]
    distance = np.linalg.norm(rays, axis=1)
    there = distance == 0
    distance[there] = 1
    rays /= distance[:, None]
    from_axis = np.arccos(np.clip((rays * poses[:, :3, 2]).sum(axis=1), -1, 1))
    parallax = np.arccos(np.clip(rays @ axis, -1, 1))
    fields = np.array([other.field for other in seen])
    apart = from_axis / fields + parallax + np.abs(np.log(distance / mine.depth))
    return np.where(there, math.inf, apart)
