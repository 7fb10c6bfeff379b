"""Views that see the same surface as a view."""

import math
from collections.abc import Sequence

import numpy as np

from tisfm.checks import Floats
from tisfm.fusion.depth_views import ViewSummary

# Bounds of the difference of two views (`_differences`), set by hand:
SIMILAR_DIFFERENCE = 0.7  # views with a smaller difference see much of the same surface
MAX_DIFFERENCE = 1.5  # views with a larger difference see hardly any of it


def choose_neighbours(
    n: int,  # number of the view
    summaries: Sequence[ViewSummary],  # all views
    count: int,  # greatest number of views returned
) -> list[int]:
    """Return other views that see the same surface as a view, the most similar ones first.

    Of the similar views (difference up to `SIMILAR_DIFFERENCE`), `count` are chosen, evenly from
    the most to the least similar view, because neighbours in time may share the same errors. If
    fewer views are similar, the views up to `MAX_DIFFERENCE` follow.
    """
    difference = _differences(summaries[n], summaries)
    difference[n] = math.inf
    order = np.argsort(difference, kind="stable")
    min_count = min(count, np.count_nonzero(difference <= MAX_DIFFERENCE))
    views = order[: max(min_count, np.count_nonzero(difference <= SIMILAR_DIFFERENCE))]
    indices = np.linspace(0, len(views) - 1, min(count, len(views))).round().astype(int)
    return [int(views[k]) for k in indices]


def _differences(view: ViewSummary, summaries: Sequence[ViewSummary]) -> Floats:
    """Return the differences of all views from a view, (N,).

    The point on the optical axis of the view, at its median depth, is compared in all views. Each
    difference is a sum of three terms: the angle between the point and the optical axis of the
    other view, as a share of its field angle; the angle between the two rays to the point, rad; and
    the absolute logarithm of the ratio of the distances.
    """
    axis = view.pose[:3, 2]
    poses = np.array([other.pose for other in summaries])
    rays = view.pose[:3, 3] + view.depth * axis - poses[:, :3, 3]
    distance = np.linalg.norm(rays, axis=1)
    is_at_point = distance == 0
    distance[is_at_point] = 1
    rays /= distance[:, None]
    from_axis = np.arccos(np.clip((rays * poses[:, :3, 2]).sum(axis=1), -1, 1))
    parallax = np.arccos(np.clip(rays @ axis, -1, 1))
    fields = np.array([other.field_angle for other in summaries])
    difference = from_axis / fields + parallax + np.abs(np.log(distance / view.depth))
    return np.where(is_at_point, math.inf, difference)
