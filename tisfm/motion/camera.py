"""One rigid motion of the camera, and inverse depth at every pixel: ``motion="camera"``."""

from dataclasses import replace

import numpy as np

from tisfm.motion.camera_doubts import find_misfit_doubt
from tisfm.motion.egomotion import sample_rays
from tisfm.motion.estimate import Estimate, make_depthless_estimate, make_estimate
from tisfm.motion.first_motion import FirstMotion, first_motion
from tisfm.motion.fixed_pixels import find_fixed_pixels
from tisfm.motion.focal_evidence import FocalEvidence
from tisfm.motion.global_depth import global_depth
from tisfm.motion.plane_sweep import PlaneSweep
from tisfm.motion.rigid_depth import Refinement, RigidSolution, rigid_depth, scaled_translations
from tisfm.motion.settings import DEPTH
from tisfm.motion.textureless_depth import textureless_depth, textureless_share
from tisfm.rigid import KnownPose
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status

# Statuses of a first motion that say how the camera turned.
STATUSES_OF_MOTION = ("little_parallax", "pure_rotation")
NO_DEPTH_YET = Status("uncertain", "fixed pixels or another focal length have to be used first")


def camera_estimate(
    pyramid: ImagePyramid,
    settings: Settings,
    pose: KnownPose | None,  # known pose, or known rotation alone
    *,
    # whether an incomplete estimate is returned if pixels are fixed on the sensor
    finds_fixed_pixels: bool = False,
    # whether an incomplete estimate is returned if the image motion shows a better focal length
    finds_focal: bool = False,
) -> Estimate:
    """Find one rigid motion and the inverse depth of every pixel directly from the images.

    A flow field of a coarser level gives a first motion (`tisfm.motion.egomotion`). Then depth and
    motion are estimated jointly, coarse to fine (`tisfm.motion.rigid_depth`). If much of a frame
    is textureless and parallax is large, depth is matched and carried across afterwards
    (`tisfm.motion.textureless_depth`). If even more is textureless, a finer flow field gives the
    motion.
    """
    camera, level = pyramid.cameras[0], pyramid.last
    labels = np.zeros(pyramid.shape, np.int32)
    if pose is not None and pose.translation is not None and not pose.translation.any():
        return make_depthless_estimate(
            pyramid,
            settings,
            level=level,
            rotation=pose.rotation,
            translation=pose.translation,
            status=Status(
                "pure_rotation",
                "the given pose has no translation, so there is no parallax and no depth",
            ),
            history=[],
        )
    given_frames1 = pyramid.frames1
    start = first_motion(
        pyramid, settings, pose=pose, min_pixels=DEPTH.min_first_pixels, use_matches=True
    )
    fixed_pixels = _find_fixed_pixels(pyramid, start, given_frames1) if finds_fixed_pixels else None
    evidence = start.focal_evidence
    replaces_focal = finds_focal and evidence is not None and evidence.replaces_guess
    if fixed_pixels is not None or start.status is not None or replaces_focal:
        status = start.status or NO_DEPTH_YET
        estimate = first_motion_estimate(pyramid, settings, start, status, level=level)
        return replace(estimate, fixed_pixels=fixed_pixels)
    if pose is None and not start.uses_matches and start.doubt is None:
        start = replace(start, doubt=_misfit_doubt(pyramid, start))
    refine: Refinement = "motion"
    unit = None
    if pose is not None:
        refine = "translation" if pose.translation is None else "none"
        unit = None if pose.translation is None else float(np.linalg.norm(pose.translation))
    motions = scaled_translations(start.matrix[None], labels, camera)
    sweep = PlaneSweep(
        pyramid, motions[0], start.level, start.flow, start.trust, is_motion_known=unit is not None
    )

    def estimate_jointly(last: int, warps: int | None = None) -> RigidSolution:
        return rigid_depth(
            pyramid,
            settings,
            motions,
            labels,
            last=last,
            refine=refine,
            start=sweep.initial_depth(),
            warps=warps,
        )

    solution: RigidSolution | None = None
    low, high = sweep.depth_range
    has_parallax = high - low >= DEPTH.min_carried_range * max(pyramid.shape)
    noisy_share = (
        textureless_share(pyramid.frames0[level], pyramid.valid0(level)) if has_parallax else 0.0
    )
    joint_solution: RigidSolution | None = None
    if noisy_share >= DEPTH.min_textureless_share:
        precise_motions = motions
        if refine != "none" and not start.uses_matches:
            if noisy_share < DEPTH.max_textureless_in_refinement:
                joint_solution = estimate_jointly(level)
                precise_motions = joint_solution.motions
            else:
                precise_motions, doubt, evidence = _refit_on_finer_flow(
                    pyramid, settings, start, pose
                )
                # the finer flow field decides whether parallax or regions make depth uncertain
                first_doubt = None if start.doubt == "uncertain" else start.doubt
                start = replace(start, doubt=first_doubt or doubt, focal_evidence=evidence)
        solution = textureless_depth(pyramid, settings, precise_motions[0])
    flow_residual = 0.0  # the deviation of carried depth includes this residual
    if solution is None:
        # A sweep may be finer than the last level. Few warps suffice: it starts near the solution.
        last = sweep.finest_level if sweep.is_needed else level
        warps = settings.warps if unit is None else None
        solution = (
            estimate_jointly(last, warps)
            if last < level
            else joint_solution or estimate_jointly(level)
        )
        flow_residual = start.residual
    # A flow field may miss a small thing altogether; a given motion allows for a search without it.
    if unit is not None or sweep.is_needed:
        # Carried depth includes the residual, and the other depth does not.
        missing_residual = start.residual - flow_residual
        joined = global_depth(pyramid, settings, solution, flow_residual=missing_residual)
        solution = joined or solution
    estimate = make_estimate(
        solution, labels, camera, settings, unit=unit, flow_residual=flow_residual
    )
    estimate = replace(
        estimate,
        level=level,
        uses_matches=start.uses_matches,
        start_flow=start.flow,
        start_level=start.level,
        light=start.light,
        focal_evidence=start.focal_evidence,
    )
    return estimate if start.doubt is None else replace(estimate, status=start.doubt)


def _misfit_doubt(pyramid: ImagePyramid, start: FirstMotion) -> Status | None:
    """Return a status if regions of a flow field move off the lines of its motion, else None."""
    rays = sample_rays(start.flow, start.trust, pyramid.cameras[start.level])
    return find_misfit_doubt(rays, (start.rotation, start.translation))


def _find_fixed_pixels(
    pyramid: ImagePyramid,
    start: FirstMotion,
    given_frames1: list[np.ndarray],  # frame 1 of each level, in its own light
) -> np.ndarray | None:
    """Return the pixels that are fixed on the sensor, (h, w) bool, or None.

    A bonnet changes with the light of the scene, a logo does not. So both frames 1 are searched.
    """
    if start.status not in (None, *STATUSES_OF_MOTION) or start.uses_matches:
        return None
    has_translation = start.translation.any() and start.status != "pure_rotation"
    unit = start.translation / np.linalg.norm(start.translation) if has_translation else None
    frames1 = [pyramid.frames1] + [given_frames1] * bool(start.light)
    found = [
        find_fixed_pixels(
            pyramid.frames0[start.level],
            frames[start.level],
            pyramid.cameras[start.level],
            start.rotation,
            unit,
            start.flow,
            start.residual * pyramid.scales[start.level],
        )
        for frames in frames1
    ]
    masks = [mask for mask in found if mask is not None]
    return np.logical_or.reduce(masks) if masks else None


def _refit_on_finer_flow(
    pyramid: ImagePyramid, settings: Settings, start: FirstMotion, pose: KnownPose | None
) -> tuple[np.ndarray, Status | None, FocalEvidence | None]:
    """Return the motion of a flow field on the last level, its doubt, and its focal evidence.

    The first motion stays if this flow field shows no motion. Depth carried across textureless
    surfaces does not refine the motion, so the motion has to be right.
    """
    pixels = pyramid.frames0[pyramid.last].size
    initial_pose = start.rotation, start.translation
    refit = first_motion(
        pyramid,
        settings,
        pose=pose,
        min_pixels=pixels,
        initial_pose=initial_pose,
        evens_light=False,
    )
    used = start if refit.status is not None else refit
    doubt = refit.doubt
    if doubt is None and pose is None:
        doubt = _misfit_doubt(pyramid, used)
    labels = np.zeros(pyramid.shape, np.int32)
    motions = scaled_translations(used.matrix[None], labels, pyramid.cameras[0])
    return motions, doubt, used.focal_evidence


def first_motion_estimate(
    pyramid: ImagePyramid, settings: Settings, start: FirstMotion, status: Status, *, level: int
) -> Estimate:
    """Return the estimate of a first motion without depth; `status` says why there is no depth."""
    estimate = make_depthless_estimate(
        pyramid,
        settings,
        level=level,
        rotation=start.rotation,
        translation=start.translation,
        status=status,
        history=start.history,
    )
    return replace(
        estimate,
        uses_matches=start.uses_matches,
        light=start.light,
        focal_evidence=start.focal_evidence,
    )
