"""Whether rigid motion and depth explain two frames: statuses of estimates that are in doubt."""

import cv2
import numpy as np

from tisfm.motion.estimate import Estimate
from tisfm.motion.frame_agreement import CORRELATED
from tisfm.motion.window_statistics import correlation, texture
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import median

# Distances of a flow from a pose, over those from the motion that fits best: at most 5.7 where
# poses are measured (7-Scenes), 17 and more where such a pose is inverted or t is reversed.
OFF = 8.0
LEAST_DISTANCE = 0.02  # px: distances from the best that are no smaller in real frames
# Of the texture that is seen: what a flow field makes alike, by as much as `BETTER`, and motion and
# depth do not. At most 0.11 where depth is off by less than a tenth, from 0.17 on where it is off
# by more than half.
UNEXPLAINED, BETTER = 0.15, 0.1
# Of the pixels that are seen: those that lie behind the camera by more than 3 deviations, and than
# a tenth of what is usual. At most 0.001 where depth is off by less than a tenth, from 0.039 on
# where it is off by more than half.
BEHIND, DEVIATIONS, BEYOND_INFINITY = 0.03, 3.0, 0.1
# Of the pixels that are seen: those whose inverse depth has a deviation of more than half of
# itself, and of what is usual. At most 0.03 where depth is off by less than 0.15.
UNSURE, UNCERTAIN = 0.5, 0.05
SAMPLED = 3  # px: of as many columns and rows, one tells
HIDDEN = 0.3  # of a pixel of a coarser level: what is not seen of it
BRIGHTER = 1.15  # times as bright in the mean, and more: the light may have changed
DOUBTS = (
    "uncertain", "little_parallax", "pure_rotation", "two_motions", "behind_camera", "unexplained",
    "unrelated", "diverged",
)  # fmt: skip


def depth_status(
    pyramid: ImagePyramid,
    estimate: Estimate,
    unseen: np.ndarray,
) -> Status | None:
    """Return why the depth of one rigid motion is wrong or uncertain, None where it is neither.

    Depth is wrong where much of it lies behind the camera, and where much of the texture is more
    alike where the flow field leads that the motion was first fitted to. Where that is not known,
    because points were matched instead, frames have to be alike where the depth leads. It is
    uncertain where its own deviation says so.

    Parameters
    ----------
    pyramid : ImagePyramid
    estimate : Estimate
        With inverse depth, its deviation and the flow field.
    unseen : (H, W) bool
        Pixels that are not visible in frame 1.
    """
    return (
        _behind(estimate, ~unseen)
        or _worse_than_flow(pyramid, estimate, unseen)
        or _unsure(estimate, ~unseen)
    )


def _behind(estimate: Estimate, seen: np.ndarray) -> Status | None:
    """Return the status of depth much of which lies behind the camera."""
    assert estimate.inverse_depth_std is not None
    sample = np.s_[::SAMPLED, ::SAMPLED]
    seen = seen[sample]
    negative = np.count_nonzero((estimate.inverse_depth[sample] < 0) & seen)
    if negative <= BEHIND * np.count_nonzero(seen):
        return None
    inverse_depth = estimate.inverse_depth[sample][seen]
    # An error that pixels share is no excuse.
    deviation = estimate.inverse_depth_std[sample][seen] / np.float32(estimate.widening)
    usual = np.float32(BEYOND_INFINITY) * median(np.abs(inverse_depth))
    share = (inverse_depth < -np.maximum(np.float32(DEVIATIONS) * deviation, usual)).mean()
    if share <= BEHIND:
        return None
    return Status(
        "behind_camera",
        f"{100 * share:.0f}% of the pixels that are seen would lie behind the camera, so depth is "
        "wrong: check the focal length, the pose if one is given, and that nothing large moves on "
        'its own (motion="objects" allows that), or take frames further apart',
    )


def _unsure(estimate: Estimate, seen: np.ndarray) -> Status | None:
    """Return the status of depth much of which has a large deviation."""
    assert estimate.inverse_depth_std is not None
    sample = np.s_[::SAMPLED, ::SAMPLED]
    seen = seen[sample]
    if not seen.any():
        return None
    inverse_depth = estimate.inverse_depth[sample][seen]
    deviation = estimate.inverse_depth_std[sample][seen]
    usual = median(np.abs(inverse_depth))
    share = (deviation > np.float32(UNSURE) * np.maximum(inverse_depth, usual)).mean()
    if share <= UNCERTAIN:
        return None
    return Status(
        "uncertain",
        f"at {100 * share:.0f}% of the pixels that are seen, inverse depth has a deviation of more "
        "than half of itself and of what is usual: take frames further apart, or move the camera "
        "sideways; result.inverse_depth_std says where depth is sure",
    )


def _worse_than_flow(
    pyramid: ImagePyramid, estimate: Estimate, unseen: np.ndarray
) -> Status | None:
    """Return the status of depth that leaves unlike what a flow field makes alike."""
    level, free = estimate.free_level, estimate.free_flow
    assert free is not None
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    size, area = frame0.shape[::-1], cv2.INTER_AREA
    flow = cv2.merge([cv2.resize(part, size, interpolation=area) for part in estimate.flow])
    alike = correlation(frame0, frame1, flow * np.float32(pyramid.scales[level]))
    seen = cv2.resize(unseen.astype(np.float32), size, interpolation=area) < HIDDEN
    weight = np.where(seen, texture(frame0), 0)
    tolerated = UNEXPLAINED * float(weight.sum())
    if float(weight[alike < 1 - BETTER].sum()) <= tolerated:  # no flow is better by as much
        return None
    worse = correlation(frame0, frame1, free) > alike + np.float32(BETTER)
    if estimate.matched:  # then the flow is that of the motion as well
        worse |= alike < CORRELATED
    left = float(weight[worse].sum())
    if left <= tolerated:
        return None
    share = UNEXPLAINED * left / tolerated
    return Status(
        "unexplained",
        f"motion and depth do not make the frames alike at {100 * share:.0f}% of the texture that "
        "is seen, so depth is wrong there: take frames closer in time, check the camera, the pose "
        'if one is given, and that nothing large moves on its own (motion="objects" allows that)',
    )


def pose_status(off: float, best: float, *, inverse: float | None = None) -> Status | None:
    """Return the status of a known pose that does not explain a flow, None if it does.

    Parameters
    ----------
    off : float
        How far the flow is from where the pose can take points, px of the finest level.
    best : float
        The same for the motion that fits best.
    inverse : float, optional
        The same for the inverse of the pose; not for a rotation alone.
    """
    tolerated = OFF * max(best, LEAST_DISTANCE)
    if off <= tolerated:
        return None
    if inverse is not None and inverse <= tolerated:
        advice = "its inverse explains them, so give np.linalg.inv(pose)"
    else:
        advice = (
            "check that it takes points from frame 0's camera to frame 1's, not back, that the "
            "axes are right, down and forward, that it is of these two frames, and the focal length"
        )
    return Status(
        "pose_mismatch",
        f"the pose given does not explain the images: they move to {off:.2g} px beside where it "
        f"can take points, the motion that fits best to {best:.2g} px; {advice}",
    )


def with_brightness_advice(status: Status, pyramid: ImagePyramid, settings: Settings) -> Status:
    """Return a status whose message also says which frame is brighter, where that may be why.

    Its code stays: what a camera sees may be brighter from another place.
    """
    if status not in DOUBTS:
        return status
    mean0, mean1 = (float(frames[-1].mean()) for frames in (pyramid.frames0, pyramid.frames1))
    dark, bright = sorted((mean0, mean1))
    if not BRIGHTER * dark <= bright < np.inf or dark <= 0:
        return status
    brighter, other = (1, 0) if mean1 > mean0 else (0, 1)
    times = bright / dark
    advice = "bring both frames to one brightness"
    weights = ["brightness"] if settings.motion == "field" else ["brightness", "depth_brightness"]
    in_use = [name for name in weights if getattr(settings, name) > 0]
    if in_use and settings.gradient > 0:  # which is left then
        advice += ", or take " + " and ".join(f"{name}=0" for name in in_use)
    return Status(
        status,
        f"{status.message}. Frame {brighter} is {times:.3g} times as bright as frame {other}: if "
        f"light or exposure changed, {advice}",
    )
