"""Errors of flow, depth, occlusion, pose, path and deviation against the truth.

They are those that the usual benchmarks define. Pixels whose truth is unknown never count: those
where it is not finite or above 1e9 in magnitude, the Middlebury convention. Masked arrays are
refused if a value is masked. Sums are float64 whatever the input.
May import: of the top level `checks` and `rigid`.
"""

from tisfm.metrics.alignment import Similarity, align
from tisfm.metrics.calibration import std_coverage
from tisfm.metrics.depth import DepthErrors, depth_error_map, depth_errors
from tisfm.metrics.depth_sequence import certain_error, flicker, limited_error
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
from tisfm.metrics.trajectory import (
    AbsoluteErrors,
    Drift,
    RelativeErrors,
    absolute_errors,
    drift,
    path_length,
    relative_errors,
)

__all__ = [
    "AbsoluteErrors",
    "DepthErrors",
    "Drift",
    "FlowErrors",
    "OcclusionScores",
    "PoseErrors",
    "RelativeErrors",
    "Similarity",
    "absolute_errors",
    "align",
    "angular_error",
    "certain_error",
    "depth_error_map",
    "depth_errors",
    "drift",
    "endpoint_error",
    "endpoint_error_map",
    "flicker",
    "flow_errors",
    "limited_error",
    "occlusion_scores",
    "outlier_rate",
    "path_length",
    "pose_errors",
    "relative_errors",
    "std_coverage",
]
