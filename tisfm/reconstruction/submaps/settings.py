"""Tuned numbers of submaps; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SubmapSettings:
    """Submaps of a long sequence, and their joining."""

    # joining
    max_views: int = 370  # views of a submap
    overlap_views: int = 40  # views that consecutive submaps share
    # approximate number of groups into which the views of all submaps are divided
    group_count: int = 120
    min_group_views: int = 8  # approximate number of views of the smallest groups
    min_shared_points: int = 15  # points that two groups share
    max_edge_points: int = 60  # points of an edge of the graph
    min_point_error: float = 0.002  # smallest assumed error of a point, divided by its distance


SUBMAPS = SubmapSettings()
