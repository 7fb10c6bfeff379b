"""Errors of flow, depth, occlusion, pose and deviation against the truth.

They are those that the usual benchmarks define. Pixels whose truth is unknown never count: those
where it is not finite or above 1e9 in magnitude, the Middlebury convention. Masked arrays are
refused if a value is masked. Sums are float64 whatever the input.
May import: of the top level `checks` and `rigid`.
"""

from tisfm.metrics.calibration import std_coverage
from tisfm.metrics.depth import DepthErrors, depth_error_map, depth_errors
from tisfm.metrics.flow import (
    FlowErrors,
    angular_error,
    endpoint_error,
    endpoint_error_map,
    flow_errors,
    outlier_rate,
)
from tisfm.metrics.occlusion import OcclusionScores, occlusion_scores
from tisfm.metrics.pose import PoseErrors, pose_errors

__all__ = [
    "DepthErrors",
    "FlowErrors",
    "OcclusionScores",
    "PoseErrors",
    "angular_error",
    "depth_error_map",
    "depth_errors",
    "endpoint_error",
    "endpoint_error_map",
    "flow_errors",
    "occlusion_scores",
    "outlier_rate",
    "pose_errors",
    "std_coverage",
]
