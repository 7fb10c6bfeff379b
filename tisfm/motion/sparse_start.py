"""First motion and flow of frames far apart: a motion from matches, depth from a plane sweep.

D is inverse depth in px/frame.
"""

from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.motion.depth_checks import pose_status
from tisfm.motion.epipolar_fit import Pose, Rays, nearest_points
from tisfm.motion.frame_agreement import unrelated_status
from tisfm.motion.homographies import TWO_MOTIONS, angle_between
from tisfm.motion.plane_sweep import MAX_COSTS, sweep_depth
from tisfm.motion.rigid_depth import scaled_translations
from tisfm.motion.settings import SPARSE
from tisfm.motion.sparse_matches import Matches, sparse_matches
from tisfm.motion.sparse_motion import (
    SparseMotion,
    known_pose_motion,
    pose_residual,
    sparse_motions,
)
from tisfm.motion.window_statistics import correlation, texture
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.occlusion import leaves_image


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseStart:
    """A motion from matches, and its flow on a level of the pyramid."""

    motion: SparseMotion  # lengths are in px of the finest level
    # (h, w, 2) float32: flow of the motion and the depth of a plane sweep, px of the level
    flow: np.ndarray
    trust: np.ndarray  # (h, w) float32: trust in the flow, in [0, 1]
    mismatch: Status | None  # set if the frames do not match even along this flow
    doubt: Status | None  # set if another motion is as likely
    rays: Rays | None = None  # all matches; None for a known pose


def sparse_start(
    pyramid: ImagePyramid,
    level: int,  # level whose frames decide between motions; the returned flow is on this level
    # (rotation, translation) or None: motion of a flow field. A motion of matches replaces it only
    # if the matches fit that motion clearly better. If several motions fit the images equally well,
    # the motion nearest to `flow_pose` is chosen.
    flow_pose: Pose | None,
) -> SparseStart | None:
    """Return the motion of matches that fits the images best; None if none beats `flow_pose`."""
    match_level, matches = _matches(pyramid)
    motions, match_cost = sparse_motions(
        matches, pyramid.cameras[match_level], pyramid.frames0[match_level].shape
    )
    if match_cost is None:
        return None
    if (
        flow_pose is not None
        and match_cost.cost(flow_pose) <= SPARSE.max_cost_ratio * motions[0].cost
    ):
        return None
    candidates = [_SweptMotion(pyramid, level, motion) for motion in motions[: SPARSE.max_motions]]
    best_score = max(candidate.score for candidate in candidates)
    best_candidates = [
        candidate
        for candidate in candidates
        if candidate.score >= best_score - SPARSE.min_correlation_gain
    ]
    winner = best_candidates[0]  # the motion of least cost for the matches
    doubt = None
    if len(best_candidates) > 1 and flow_pose is not None:
        winner = min(
            best_candidates,
            key=lambda candidate: angle_between(candidate.motion.translation, flow_pose[1]),
        )
    if len(best_candidates) > 1 and (flow_pose is None or winner.motion.model == "plane"):
        doubt = TWO_MOTIONS
    start = winner.start(1 / pyramid.scales[match_level], doubt)
    return replace(start, rays=match_cost.rays)


def known_pose_start(
    pyramid: ImagePyramid,
    level: int,
    pose: Pose,  # (rotation, translation): ‖t‖ = 1
) -> tuple[SparseStart | None, Status | None]:
    """Return the start for a known motion, and a status if the motion seems wrong.

    The start is None if too few matches agree with the motion. The status is set only if another
    motion fits the matches far better.
    """
    match_level, matches = _matches(pyramid)
    camera, shape = pyramid.cameras[match_level], pyramid.frames0[match_level].shape
    px_factor = 1 / pyramid.scales[match_level]
    motions, _ = sparse_motions(matches, camera, shape)
    doubt = None
    if motions and _SweptMotion(pyramid, level, motions[0]).mismatch is None:
        rotation, translation = pose
        residual, inverse_pose_residual = (
            px_factor * pose_residual(motions[0].rays, candidate)
            for candidate in (pose, (rotation.T, -rotation.T @ translation))
        )
        best_residual = px_factor * max(motions[0].residual, SPARSE.min_residual)
        doubt = pose_status(residual, best_residual, inverse_pose_residual=inverse_pose_residual)
    motion = known_pose_motion(matches, camera, shape, pose)
    if motion is None:
        return None, doubt
    return _SweptMotion(pyramid, level, motion).start(px_factor, doubt), doubt


def _matches(pyramid: ImagePyramid) -> tuple[int, Matches]:
    """Return the finest level of at most `max_pixels` pixels, and matches of its frames."""
    match_level = next(
        (k for k, frame in enumerate(pyramid.frames0) if frame.size <= SPARSE.max_pixels),
        pyramid.levels - 1,
    )
    frames = pyramid.frames0[match_level], pyramid.frames1[match_level]
    return match_level, sparse_matches(*frames, pyramid.valid_on(match_level))


class _SweptMotion:
    """The flow of a motion on a level, with depth from a plane sweep, and its fit."""

    def __init__(self, pyramid: ImagePyramid, level: int, motion: SparseMotion) -> None:
        self.motion = motion
        frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
        camera = pyramid.cameras[level]
        pose = np.column_stack([motion.rotation, motion.translation])
        labels = np.zeros(frame0.shape, np.int32)
        scaled_pose = scaled_translations(pose[None], labels, camera)[0]
        inverse_depth = nearest_points(
            motion.rays, motion.rotation, motion.translation
        ).inverse_depth
        # inverse depth D of the matches, px/frame
        match_depths = inverse_depth * (camera.focal / np.linalg.norm(scaled_pose[:, 3]))
        max_depth = min(
            SPARSE.depth_margin * float(np.percentile(match_depths, SPARSE.depth_percentile)),
            max(frame0.shape),
        )
        hypotheses = np.arange(max(np.ceil(max_depth), SPARSE.min_hypotheses))
        hypotheses = hypotheses[: max(SPARSE.min_hypotheses, MAX_COSTS // frame0.size)]
        guess = np.full_like(frame0, np.median(match_depths))
        depth = sweep_depth(
            frame0,
            frame1,
            scaled_pose,
            camera,
            hypotheses,
            guess,
            np.zeros_like(guess),
            valid=pyramid.valid_on(level),
        )
        self.flow = depth_flow(depth, scaled_pose, camera)
        correlations = correlation(frame0, frame1, self.flow)
        hidden = leaves_image(np.moveaxis(self.flow, -1, 0))
        if pyramid.masks is not None:
            hidden |= pyramid.masks.ignored_pixels(np.moveaxis(self.flow, -1, 0), level)
        weight = np.where(hidden, 0, texture(frame0))
        total_weight = float(weight.sum())
        self.score = (
            float((weight * correlations).sum() / total_weight) if total_weight > 0 else -1.0
        )
        self.trust = np.clip(weight * correlations, 0, 1).astype(np.float32)
        self.mismatch = (
            unrelated_status(frame0, frame1, self.flow, weight, is_unrestricted=False)
            if total_weight > 0
            else None
        )

    def start(self, px_factor: float, doubt: Status | None) -> SparseStart:
        """Return the start, with lengths of the motion multiplied by `px_factor`."""
        return SparseStart(
            motion=self.motion.scaled(px_factor),
            flow=self.flow,
            trust=self.trust,
            mismatch=self.mismatch,
            doubt=doubt,
        )


def depth_flow(depth: np.ndarray, motion: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the flow of pixels with inverse depth D under a motion, (h, w, 2), px/frame."""
    height, width = depth.shape
    cx, cy = camera.center_for(height, width)
    x = (np.arange(width) - cx) / camera.focal
    y = (np.arange(height)[:, None] - cy) / camera.focal
    rays = np.stack(np.broadcast_arrays(x, y, np.ones_like(depth)))
    points = np.einsum("ij,jhw->ihw", motion[:, :3], rays)
    points += depth * (motion[:, 3] / camera.focal)[:, None, None]
    nearness = 1 / np.maximum(points[2], MIN_DEPTH_RATIO)
    flow = np.stack([points[0] * nearness - x, points[1] * nearness - y], axis=-1)
    return (camera.focal * flow).astype(np.float32)
