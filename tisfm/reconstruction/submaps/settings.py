"""Tuned numbers of submaps; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SubmapSettings:
    """Submaps of a long sequence, and their joining."""

    # joining
    max_views: int = 370  # of a submap
    overlap_views: int = 40  # that consecutive submaps share
    group_count: int = 120  # groups into which the views of all submaps are divided, roughly
    min_group_views: int = 8  # of a group, roughly
    min_shared_points: int = 15  # of two groups of one submap
    max_edge_points: int = 60  # that an edge of the graph keeps
    min_point_error: float = 0.002  # assumed error of a point, as a share of its distance


SUBMAPS = SubmapSettings()
