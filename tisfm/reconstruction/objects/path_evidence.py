"""Evidence from the camera path on static pixels: one depth has to fit many frames.

In two frames, an object that moves along epipolar lines looks like static points at another depth.
Over many frames, such a motion hardly ever fits one depth.
"""

from collections.abc import Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.image_motion import ChainedFlow, ImageMotion
from tisfm.reconstruction.objects.motion_evidence import (
    Evidence,
    StaticMotion,
    evidence_of_error,
    support_of_motion,
)
from tisfm.reconstruction.objects.settings import OBJECTS


def path_evidence(
    motion: ImageMotion,
    frame: int,
    # sequence of (4, 4) array or None: camera to world, of every frame, in one scale; None for a
    # frame without a pose
    poses: Sequence[np.ndarray | None],
    camera: Camera,  # a pinhole, for the frames of the image motion
    moving_pixels: np.ndarray,  # (H, W) bool: pixels that are known to move
) -> tuple[Evidence, np.ndarray] | None:
    """Return the evidence of many frames on a frame's pixels, under known poses, or None.

    Also return the inverse depth, (H, W) float32, that fits these frames best.
    """
    pose = poses[frame]
    if pose is None:
        return None
    shape = motion.grey(frame).shape
    views: list[tuple[ChainedFlow, StaticMotion]] = []
    for chain in motion.chained_flows(frame, max(OBJECTS.path_steps)):
        other = poses[chain.frame]
        if chain.steps in OBJECTS.path_steps and other is not None:
            views.append((chain, StaticMotion.between(pose, other, camera, shape)))
    if len(views) < 2:
        return None
    inverse_depth, error = _joint_depth(views, shape)
    count = np.sum([chain.valid for chain, _ in views], axis=0)
    static_pixels = (count >= 2) & ~moving_pixels
    if static_pixels.sum() < 100:
        return None
    deviation = 1.48 * float(np.median(error[static_pixels]))
    if deviation > OBJECTS.max_path_error * max(shape):
        return None
    deviation += OBJECTS.flow_deviation / 2 * max(shape)  # many frames are more certain than one
    vote = evidence_of_error(error / (deviation * OBJECTS.neutral_deviations))
    static_depths = inverse_depth[static_pixels & (vote < 0)]
    last_views = {chain.frame > frame: (chain, static) for chain, static in views}  # by side
    compared = [
        (motion.grey(chain.frame), chain.positions, chain.valid, static)
        for chain, static in last_views.values()
    ]
    support = support_of_motion(motion.grey(frame), compared, inverse_depth, static_depths)
    weight = np.where(vote > 0, support, 1) * np.minimum(count / len(views) * 2, 1) * (count >= 2)
    evidence = Evidence(total=np.float32(vote * weight), weight=np.float32(weight))
    return evidence, inverse_depth


def _joint_depth(
    views: Sequence[tuple[ChainedFlow, StaticMotion]], shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse depth that fits all views best, and its error, px, (H, W) each."""
    inverse_depth = np.zeros(shape, np.float32)
    for fit_round in range(OBJECTS.depth_rounds):
        squares, products = np.full(shape, 1e-12, np.float32), np.zeros(shape, np.float32)
        for chain, static in views:
            slope, residual = static.slope_and_residual(inverse_depth, chain.positions)
            weight = chain.valid / np.float32(chain.steps)  # errors add up along a chain
            if fit_round:
                error = np.linalg.norm(residual, axis=-1) / np.float32(chain.steps**0.5)
                weight = weight / (1 + (error / OBJECTS.outlier_error) ** 2)
            squares += weight * (slope * slope).sum(axis=-1)
            products += weight * (slope * residual).sum(axis=-1)
        inverse_depth = np.maximum(inverse_depth + products / squares, 0)
    total, count = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for chain, static in views:
        error = np.linalg.norm(static.positions(inverse_depth) - chain.positions, axis=-1)
        total += chain.valid * error**2 / chain.steps
        count += chain.valid
    return inverse_depth, np.sqrt(total / np.maximum(count, 1))
