"""Tuned numbers of similarities; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class GeometrySettings:
    """Robust fits of similarities, and their graph."""

    # sim3; errors of points are divided by their distances from the camera
    ransac_trials: int = 200  # RANSAC trials, each with three points
    max_inlier_error: float = 0.05  # error of an inlier
    min_inliers: int = 20  # inliers of a similarity
    min_inlier_share: float = 0.5  # share of inliers among all points
    fit_rounds: int = 5  # rounds of the reweighted fit to inliers
    outlier_scale: float = 2.0  # error with half the weight, divided by the median error
    # sim3_graph
    max_rounds: int = 20  # Gauss–Newton rounds
    # root mean square error of an edge's points, in the first round: beyond it, an edge that may be
    # wrong, such as a closed loop, has a decreasing weight
    first_outlier_error: float = 1.0
    outlier_error_factor: float = 0.6  # factor of this error from round to round
    last_outlier_error: float = 0.02  # the smallest value of this error
    min_step: float = 1e-9  # a smaller step of all unknowns ends the rounds


GEOMETRY = GeometrySettings()
