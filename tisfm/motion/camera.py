"""One rigid motion of the camera, and inverse depth at every pixel: ``motion="camera"``."""

from dataclasses import replace

import numpy as np

from tisfm.motion.estimate import Estimate
from tisfm.motion.first_motion import FirstMotion, first_motion
from tisfm.motion.plane_sweep import swept_start
from tisfm.motion.rigid_depth import Refinement, rigid_depth, scaled_translations
from tisfm.motion.rigid_estimate import with_depth, without_depth
from tisfm.outcome import Status
from tisfm.rigid import KnownPose
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid

START = 2**14  # pixels, at least, of the flow field that the camera's motion is first found from


def camera_estimate(pyramid: ImagePyramid, settings: Settings, pose: KnownPose | None) -> Estimate:
    """Find one rigid motion and the inverse depth of every pixel, both from the images directly.

    A flow field of a coarser level gives a first motion (`tisfm.motion.egomotion`). Depth and
    motion then are estimated jointly, coarse to fine (`tisfm.motion.rigid_depth`).

    Parameters
    ----------
    pyramid : ImagePyramid
    settings : Settings
    pose : KnownPose or None
        What is known of the motion.
    """
    camera, level = pyramid.cameras[0], pyramid.last
    labels = np.zeros(pyramid.shape, np.int32)
    if pose is not None and pose.translation is not None and not pose.translation.any():
        return without_depth(
            pyramid,
            settings,
            level=level,
            rotation=pose.rotation,
            translation=pose.translation,
            status=Status(
                "pure_rotation",
                "the pose given has no translation, so there is no parallax to see depth by",
            ),
            history=[],
        )
    start = first_motion(pyramid, settings, pose=pose, pixels=START, matches=True)
    if start.status is not None:
        return only_turned(pyramid, settings, start, start.status, level=level)
    motions = scaled_translations(start.matrix[None], labels, camera)
    refine: Refinement = "motion"
    unit = None
    if pose is not None:
        refine = "translation" if pose.translation is None else "none"
        unit = None if pose.translation is None else float(np.linalg.norm(pose.translation))
    solution = rigid_depth(
        pyramid,
        settings,
        motions,
        labels,
        last=level,
        refine=refine,
        start=swept_start(pyramid, motions[0], start.level, start.flow, start.trust),
    )
    estimate = with_depth(solution, labels, camera, settings, unit=unit)
    estimate = replace(estimate, level=level, matched=start.matched)
    return estimate if start.doubt is None else replace(estimate, status=start.doubt)


def only_turned(
    pyramid: ImagePyramid, settings: Settings, start: FirstMotion, status: Status, *, level: int
) -> Estimate:
    """Return what is left of a first motion whose depth is not to be seen, and why."""
    return without_depth(
        pyramid,
        settings,
        level=level,
        rotation=start.rotation,
        translation=start.translation,
        status=status,
        history=start.history,
    )
