"""Evidence from the camera path on static pixels: one depth has to fit many frames.

In two frames, an object that moves along epipolar lines looks like static points at another depth.
Over many frames, such a motion hardly ever fits one depth.
"""

from collections.abc import Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.image_motion import ChainedFlow, ImageMotion
from tisfm.reconstruction.objects.motion_evidence import (
    MIN_DEVIATION,
    MOVING_EVIDENCE,
    NEUTRAL_DEVIATIONS,
    STATIC_EVIDENCE,
    Evidence,
    StaticMotion,
    support_of_motion,
)

# Values without a stated source were set by hand.

# Frames before and after that one depth has to explain.
FRAME_STEPS = (1, 2, 3, 5, 8)
# Reweighted rounds of the robust fit of depth.
FIT_ROUNDS = 3
# px per square root of the frame distance: error with half the weight.
OUTLIER_PIXELS = 3.0
# Largest usual error, as a share of the longer side; with a larger one, the path does not fit the
# static points.
MAX_USUAL_ERROR = 1.5e-3


def path_evidence(
    motion: ImageMotion,
    frame: int,
    # sequence of (4, 4) array or None: camera to world, of every frame, in one scale; None for a
    # frame without a pose
    poses: Sequence[np.ndarray | None],
    camera: Camera,  # a pinhole, for the frames of the image motion
    moving: np.ndarray,  # (H, W) bool: pixels that are known to move
) -> tuple[Evidence, np.ndarray] | None:
    """Return the evidence of many frames on a frame's pixels, under known poses, or None.

    Also return the inverse depth, (H, W) float32, that fits these frames best.
    """
    pose = poses[frame]
    if pose is None:
        return None
    shape = motion.grey(frame).shape
    views: list[tuple[ChainedFlow, StaticMotion]] = []
    for led in motion.chained_flows(frame, max(FRAME_STEPS)):
        other = poses[led.frame]
        if led.steps in FRAME_STEPS and other is not None:
            relative = np.linalg.inv(other) @ pose
            views.append((led, StaticMotion(relative[:3, :3], relative[:3, 3], camera, shape)))
    if len(views) < 2:
        return None
    inverse_depth, far = _joint_depth(views, shape)
    seen = np.sum([led.found for led, _ in views], axis=0)
    resting = (seen >= 2) & ~moving
    if resting.sum() < 100:
        return None
    usual = 1.48 * float(np.median(far[resting]))
    if usual > MAX_USUAL_ERROR * max(shape):
        return None
    usual += MIN_DEVIATION / 2 * max(shape)  # many frames are more certain than one
    says = np.clip((far / (usual * NEUTRAL_DEVIATIONS)) ** 2 - 1, STATIC_EVIDENCE, MOVING_EVIDENCE)
    near = inverse_depth[resting & (says < 0)]
    last = {led.frame > frame: (led, at_rest) for led, at_rest in views}  # by side
    compared = [
        (motion.grey(led.frame), led.places, led.found, at_rest) for led, at_rest in last.values()
    ]
    clear = support_of_motion(motion.grey(frame), compared, inverse_depth, near)
    weight = np.where(says > 0, clear, 1) * np.minimum(seen / len(views) * 2, 1) * (seen >= 2)
    found = Evidence(moving=np.float32(says * weight), weight=np.float32(weight))
    return found, inverse_depth


def _joint_depth(
    views: Sequence[tuple[ChainedFlow, StaticMotion]], shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse depth that fits all views best, and its error, px, (H, W) each."""
    inverse_depth = np.zeros(shape, np.float32)
    for number in range(FIT_ROUNDS):
        squares, products = np.full(shape, 1e-12, np.float32), np.zeros(shape, np.float32)
        for led, at_rest in views:
            slope, missed = at_rest.slope_and_missed(inverse_depth, led.places)
            weight = led.found / np.float32(led.steps)  # errors add up along a chain
            if number:
                off = np.linalg.norm(missed, axis=-1) / np.float32(led.steps**0.5)
                weight = weight / (1 + (off / OUTLIER_PIXELS) ** 2)
            squares += weight * (slope * slope).sum(axis=-1)
            products += weight * (slope * missed).sum(axis=-1)
        inverse_depth = np.maximum(inverse_depth + products / squares, 0)
    total, count = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for led, at_rest in views:
        off = np.linalg.norm(at_rest.places(inverse_depth) - led.places, axis=-1)
        total += led.found * off**2 / led.steps
        count += led.found
    return inverse_depth, np.sqrt(total / np.maximum(count, 1))
