"""The start for frames far apart: a motion from matches, and depth from a plane sweep."""

from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.model.constants import NEAREST
from tisfm.motion.depth_checks import pose_status
from tisfm.motion.epipolar_fit import Pose, nearest_points
from tisfm.motion.frame_agreement import unrelated
from tisfm.motion.plane_ambiguity import TWO_MOTIONS
from tisfm.motion.plane_sweep import ENTRIES, swept
from tisfm.motion.rigid_depth import scaled_translations
from tisfm.motion.sparse_matches import LARGEST, Matches, sparse_matches
from tisfm.motion.sparse_motion import (
    SMALLEST_RESIDUAL,
    TIED,
    SparseMotion,
    angle,
    posed_motion,
    posed_residual,
    sparse_motions,
)
from tisfm.motion.window_statistics import correlation, texture
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.occlusion import leaves_image

MOST = 3  # motions that the images compare
RARE, FURTHER = 99, 1.5  # percentile of the matches' D, and largest D of the sweep relative to it
FEWEST_HYPOTHESES = 4
UNDECIDED = 0.01  # difference of mean correlations below which two motions are equally good


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseStart:
    """A motion from matches, and its flow on a level of the pyramid."""

    motion: SparseMotion  # lengths are in px of the finest level
    # (h, w, 2) float32: flow of the motion and the depth of a plane sweep, px of the level
    flow: np.ndarray
    trust: np.ndarray  # (h, w) float32: trust in the flow, in [0, 1]
    apart: Status | None  # set if the frames do not match even along this flow
    doubt: Status | None  # set if another motion is as likely


def sparse_start(
    pyramid: ImagePyramid,
    level: int,  # level on which the images compare motions; the returned flow is on this level
    # (rotation, translation) or None: motion of a flow field. It is kept if the matches fit it
    # nearly as well as their best motion. It decides between motions that fit the images equally
    # well.
    dense: Pose | None,
) -> SparseStart | None:
    """Return the motion of matches that fits the images best; None if there is no better motion."""
    finest, matches = _matches(pyramid)
    motions, judge = sparse_motions(matches, pyramid.cameras[finest], pyramid.frames0[finest].shape)
    if judge is None:
        return None
    if dense is not None and judge.cost(dense) <= TIED * motions[0].cost:
        return None
    views = [_View(pyramid, level, motion) for motion in motions[:MOST]]
    best = max(view.score for view in views)
    likely = [view for view in views if view.score >= best - UNDECIDED]
    chosen = likely[0]  # the motion of least cost for the matches
    doubt = None
    if len(likely) > 1 and dense is not None:
        chosen = min(likely, key=lambda view: angle(view.motion.translation, dense[1]))
    if len(likely) > 1 and (dense is None or chosen.motion.model == "plane"):
        doubt = TWO_MOTIONS
    return chosen.start(1 / pyramid.scales[finest], doubt)


def posed_start(
    pyramid: ImagePyramid,
    level: int,
    pose: Pose,  # (rotation, translation): ‖t‖ = 1
) -> tuple[SparseStart | None, Status | None]:
    """Return the start for a known motion, and why the motion is wrong.

    The first is None if too few matches agree with the motion. The second is None if no other
    motion fits the matches far better.
    """
    finest, matches = _matches(pyramid)
    camera, shape = pyramid.cameras[finest], pyramid.frames0[finest].shape
    length = 1 / pyramid.scales[finest]
    motions, _ = sparse_motions(matches, camera, shape)
    doubt = None
    if motions and _View(pyramid, level, motions[0]).apart is None:
        rotation, translation = pose
        off, back = (
            length * posed_residual(motions[0].rays, way)
            for way in (pose, (rotation.T, -rotation.T @ translation))
        )
        best = length * max(motions[0].residual, SMALLEST_RESIDUAL)
        doubt = pose_status(off, best, inverse=back)
    motion = posed_motion(matches, camera, shape, pose)
    if motion is None:
        return None, doubt
    return _View(pyramid, level, motion).start(length, doubt), doubt


def _matches(pyramid: ImagePyramid) -> tuple[int, Matches]:
    """Return the finest level of at most `LARGEST` pixels, and matches of its frames."""
    finest = next(
        (k for k, frame in enumerate(pyramid.frames0) if frame.size <= LARGEST), pyramid.levels - 1
    )
    frames = pyramid.frames0[finest], pyramid.frames1[finest]
    return finest, sparse_matches(*frames, pyramid.counted_on(finest))


class _View:
    """A level of the pyramid under one motion: depth by a plane sweep, and frame correlation."""

    def __init__(self, pyramid: ImagePyramid, level: int, motion: SparseMotion) -> None:
        self.motion = motion
        frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
        camera = pyramid.cameras[level]
        pose = np.column_stack([motion.rotation, motion.translation])
        labels = np.zeros(frame0.shape, np.int32)
        scaled = scaled_translations(pose[None], labels, camera)[0]
        inverse_depth = nearest_points(
            motion.rays, motion.rotation, motion.translation
        ).inverse_depth
        seen = inverse_depth * (camera.focal / np.linalg.norm(scaled[:, 3]))  # D of the matches
        high = min(FURTHER * float(np.percentile(seen, RARE)), max(frame0.shape))
        hypotheses = np.arange(max(np.ceil(high), FEWEST_HYPOTHESES))
        hypotheses = hypotheses[: max(FEWEST_HYPOTHESES, ENTRIES // frame0.size)]
        guess = np.full_like(frame0, np.median(seen))
        depth = swept(
            frame0,
            frame1,
            scaled,
            camera,
            hypotheses,
            guess,
            np.zeros_like(guess),
            counted=pyramid.counted_on(level),
        )
        self.flow = _flow(depth, scaled, camera)
        alike = correlation(frame0, frame1, self.flow)
        unseen = leaves_image(np.moveaxis(self.flow, -1, 0))
        if pyramid.counted is not None:
            unseen |= pyramid.counted.missing(np.moveaxis(self.flow, -1, 0), level)
        weight = np.where(unseen, 0, texture(frame0))
        total = float(weight.sum())
        self.score = float((weight * alike).sum() / total) if total > 0 else -1.0
        self.trust = np.clip(weight * alike, 0, 1).astype(np.float32)
        self.apart = unrelated(frame0, frame1, self.flow, weight, free=False) if total > 0 else None

    def start(self, enlarged: float, doubt: Status | None) -> SparseStart:
        """Return the start, with lengths of the motion multiplied by `enlarged`."""
        return SparseStart(
            motion=self.motion.scaled(enlarged),
            flow=self.flow,
            trust=self.trust,
            apart=self.apart,
            doubt=doubt,
        )


def _flow(depth: np.ndarray, motion: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the flow of points of inverse depth D under a motion, (h, w, 2), px/frame."""
    height, width = depth.shape
    cx, cy = camera.center_for(height, width)
    x = (np.arange(width) - cx) / camera.focal
    y = (np.arange(height)[:, None] - cy) / camera.focal
    rays = np.stack(np.broadcast_arrays(x, y, np.ones_like(depth)))
    moved = np.einsum("ij,jhw->ihw", motion[:, :3], rays)
    moved += depth * (motion[:, 3] / camera.focal)[:, None, None]
    nearness = 1 / np.maximum(moved[2], NEAREST)
    flow = np.stack([moved[0] * nearness - x, moved[1] * nearness - y], axis=-1)
    return (camera.focal * flow).astype(np.float32)
