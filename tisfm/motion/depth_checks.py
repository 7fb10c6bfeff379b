"""Whether rigid motion and depth explain two frames: statuses of estimates that are in doubt."""

import cv2
import numpy as np

from tisfm.grade import GRADES, depth_error, percent
from tisfm.motion.estimate import Estimate
from tisfm.motion.settings import CHECKS
from tisfm.motion.window_statistics import correlation, texture
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import median

SAMPLE_STEP = 3  # px: every third row and column is used
# Statuses that a change of brightness may cause.
DOUBTFUL_STATUSES = (
    "uncertain", "little_parallax", "pure_rotation", "two_motions", "behind_camera", "unexplained",
    "unrelated", "diverged",
)  # fmt: skip


def depth_status(
    pyramid: ImagePyramid,
    estimate: Estimate,  # with inverse depth, its deviation and the flow field
    hidden: np.ndarray,  # (H, W) bool: pixels that are not visible in frame 1
) -> Status | None:
    """Return the status of wrong or uncertain depth of one rigid motion, None for others.

    Depth is wrong if many pixels lie behind the camera, or if the flow field of the first motion
    aligns much of the texture better. If points were matched instead, the first motion has no flow
    field, and depth itself has to align the frames. Depth is uncertain if its standard
    deviation is large at many pixels.
    """
    return (
        _behind_status(estimate, ~hidden)
        or _unexplained_status(pyramid, estimate, hidden)
        or _uncertain_status(estimate, ~hidden)
    )


def _behind_status(estimate: Estimate, visible: np.ndarray) -> Status | None:
    """Return the status of depth that is negative at many pixels, None for others."""
    assert estimate.inverse_depth_std is not None
    sample = np.s_[::SAMPLE_STEP, ::SAMPLE_STEP]
    visible = visible[sample]
    negative_count = np.count_nonzero((estimate.inverse_depth[sample] < 0) & visible)
    if negative_count <= CHECKS.max_behind_share * np.count_nonzero(visible):
        return None
    inverse_depth = estimate.inverse_depth[sample][visible]
    # This deviation does not contain the errors that many pixels have in common.
    deviation = estimate.inverse_depth_std[sample][visible] / np.float32(estimate.deviation_factor)
    min_depth = np.float32(CHECKS.min_behind_depth) * median(np.abs(inverse_depth))
    share = (
        inverse_depth < -np.maximum(np.float32(CHECKS.min_behind_deviations) * deviation, min_depth)
    ).mean()
    if share <= CHECKS.max_behind_share:
        return None
    return Status(
        "behind_camera",
        f"{100 * share:.0f}% of the visible pixels would lie behind the camera, so depth is "
        "wrong: check the focal length and a given pose, take frames farther apart, or "
        'choose motion="objects" if large objects move',
    )


def _uncertain_status(estimate: Estimate, visible: np.ndarray) -> Status | None:
    """Return the status of depth with a large deviation at many pixels, None for others.

    The expected error is that of the grade, for the given focal length.
    """
    assert estimate.inverse_depth_std is not None
    deviation = np.where(visible, estimate.inverse_depth_std, np.float32(np.inf))
    expected_error, _ = depth_error(estimate.inverse_depth, deviation)
    if expected_error > GRADES.max_fair:
        return Status(
            "uncertain",
            f"half of the depth is expected to be off by more than {percent(expected_error)}: "
            "take frames farther apart, or move the camera sideways; result.inverse_depth_std "
            "tells where depth is reliable",
        )
    sample = np.s_[::SAMPLE_STEP, ::SAMPLE_STEP]
    visible = visible[sample]
    if not visible.any():
        return None
    inverse_depth = estimate.inverse_depth[sample][visible]
    deviation = estimate.inverse_depth_std[sample][visible]
    median_depth = median(np.abs(inverse_depth))
    relative_deviation = deviation / np.maximum(inverse_depth, median_depth)
    share = (relative_deviation > np.float32(CHECKS.max_relative_deviation)).mean()
    if share <= CHECKS.max_uncertain_share:
        return None
    return Status(
        "uncertain",
        f"at {100 * share:.0f}% of the visible pixels, the deviation of inverse depth exceeds half "
        "of its value and half of the median: take frames farther apart, or move the camera "
        "sideways; result.inverse_depth_std tells where depth is reliable",
    )


def _unexplained_status(
    pyramid: ImagePyramid, estimate: Estimate, hidden: np.ndarray
) -> Status | None:
    """Return the status of depth that aligns frames worse than a flow field, None for others."""
    level, start_flow = estimate.start_level, estimate.start_flow
    assert start_flow is not None
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    size, mode = frame0.shape[::-1], cv2.INTER_AREA
    flow = cv2.merge([cv2.resize(part, size, interpolation=mode) for part in estimate.flow])
    correlations = correlation(frame0, frame1, flow * np.float32(pyramid.scales[level]))
    visible = (
        cv2.resize(hidden.astype(np.float32), size, interpolation=mode) < CHECKS.max_hidden_share
    )
    weight = np.where(visible, texture(frame0), 0)
    max_weight = CHECKS.max_unexplained_share * float(weight.sum())
    # A correlation is at most 1, so elsewhere no flow can be better by `min_correlation_gain`.
    if float(weight[correlations < 1 - CHECKS.min_correlation_gain].sum()) <= max_weight:
        return None
    is_worse = correlation(frame0, frame1, start_flow) > correlations + np.float32(
        CHECKS.min_correlation_gain
    )
    if estimate.uses_matches:  # then `start_flow` itself follows from the motion
        is_worse |= correlations < CHECKS.min_correlation
    worse_weight = float(weight[is_worse].sum())
    if worse_weight <= max_weight:
        return None
    share = CHECKS.max_unexplained_share * worse_weight / max_weight
    return Status(
        "unexplained",
        f"motion and depth do not align the frames at {100 * share:.0f}% of the visible texture, "
        "so depth is wrong there: take frames closer in time, check the camera and a given pose, "
        'or choose motion="objects" if large objects move',
    )


def pose_status(
    residual: float,  # distance of the flow from the pose's epipolar lines, px of the finest level
    best_residual: float,  # this distance for the motion that fits best, px
    *,
    # this distance for the inverse of the pose, px; None for a rotation alone
    inverse_pose_residual: float | None = None,
) -> Status | None:
    """Return the status of a given pose that contradicts a flow, None for others."""
    max_residual = CHECKS.max_pose_ratio * max(best_residual, CHECKS.min_pose_distance)
    if residual <= max_residual:
        return None
    if inverse_pose_residual is not None and inverse_pose_residual <= max_residual:
        advice = "its inverse fits, so give np.linalg.inv(pose)"
    else:
        advice = (
            "check that it maps points from frame 0's camera to frame 1's, that its axes point "
            "right, down and forward, that it belongs to these frames, and the focal length"
        )
    return Status(
        "pose_mismatch",
        f"the given pose contradicts the images: points lie {residual:.2g} px from its epipolar "
        f"lines, but {best_residual:.2g} px from the lines of the best motion; {advice}",
    )


def with_brightness_advice(status: Status, pyramid: ImagePyramid, settings: Settings) -> Status:
    """Return a status; if brightness may be the reason, its message also names the brighter frame.

    The code of the status stays: a scene may be brighter from another position.
    """
    if status not in DOUBTFUL_STATUSES:
        return status
    mean0, mean1 = (float(frames[-1].mean()) for frames in (pyramid.frames0, pyramid.frames1))
    min_mean, max_mean = sorted((mean0, mean1))
    if not CHECKS.min_brightness_ratio * min_mean <= max_mean < np.inf or min_mean <= 0:
        return status
    brighter, darker = (1, 0) if mean1 > mean0 else (0, 1)
    ratio = max_mean / min_mean
    advice = "bring both frames to one brightness"
    weights = ["brightness"] if settings.motion == "field" else ["brightness", "depth_brightness"]
    used_weights = [name for name in weights if getattr(settings, name) > 0]
    if used_weights and settings.gradient > 0:  # the data term then keeps the gradient
        advice += ", or set " + " and ".join(f"{name}=0" for name in used_weights)
    return Status(
        status,
        f"{status.message}. Frame {brighter} is {ratio:.3g} times as bright as frame {darker}: if "
        f"light or exposure changed, {advice}",
    )
