"""Tuned numbers of similarities; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class GeometrySettings:
    """Robust fits of similarities, and their graph."""

    # sim3; errors are shares of the distance from the camera
    ransac_trials: int = 200  # each with three points
    max_inlier_error: float = 0.05  # of an inlier
    min_inliers: int = 20  # of a similarity
    min_inlier_share: float = 0.5  # of all points
    fit_rounds: int = 5  # reweighted rounds of the fit to inliers
    outlier_scale: float = 2.0  # median errors: an error with half the weight
    # sim3_graph
    max_rounds: int = 20  # Gauss–Newton rounds
    first_outlier_error: float = 1.0  # of an uncertain edge; larger errors have a decreasing weight
    outlier_error_factor: float = 0.6  # change of this error in each round
    last_outlier_error: float = 0.02  # of this error
    min_step: float = 1e-9  # of all unknowns: smaller ones end the rounds


GEOMETRY = GeometrySettings()
