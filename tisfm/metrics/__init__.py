"""Errors of flow, depth, occlusion, pose, trajectory, labels and standard deviation.

They are defined as in the usual benchmarks. Pixels without ground truth are not compared: their
true value is not finite, or above 1e9 in magnitude (the convention of Middlebury). Masked arrays
are refused if a value is masked. Sums are float64 for any input.

May import: of the top level `checks` and `rigid`.
"""

from tisfm.metrics.alignment import Similarity, align
from tisfm.metrics.depth import DepthErrors, depth_error_map, depth_errors
from tisfm.metrics.depth_outlines import (
    RegionErrors,
    outlines,
    outlines_of_blurred_depth,
    region_errors,
)
from tisfm.metrics.depth_sequence import certain_error, flicker, limited_error
from tisfm.metrics.depth_std import std_coverage
from tisfm.metrics.flow import (
    FlowErrors,
    angular_error,
    endpoint_error,
    endpoint_error_map,
    flow_errors,
    outlier_rate,
)
from tisfm.metrics.labels import LabelScores, ObjectScores, label_scores
from tisfm.metrics.object_path import ObjectPathErrors, object_path_errors
from tisfm.metrics.occlusion import OcclusionScores, occlusion_scores
from tisfm.metrics.pose import PoseErrors, pose_errors
from tisfm.metrics.trajectory_errors import (
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
    "LabelScores",
    "ObjectPathErrors",
    "ObjectScores",
    "OcclusionScores",
    "PoseErrors",
    "RegionErrors",
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
    "label_scores",
    "limited_error",
    "object_path_errors",
    "occlusion_scores",
    "outlier_rate",
    "outlines",
    "outlines_of_blurred_depth",
    "path_length",
    "pose_errors",
    "region_errors",
    "relative_errors",
    "std_coverage",
]
