"""The motion that most of a flow field shows: where ``"camera"`` and ``"objects"`` start."""

import math
from dataclasses import dataclass, replace

import numpy as np

from tisfm.motion.camera_doubts import examine_camera
from tisfm.motion.depth_checks import pose_status
from tisfm.motion.egomotion import (
    CameraMotion,
    TooFewPixelsError,
    camera_motion,
    deviation_from_pose,
    refine_motion,
    sample_rays,
)
from tisfm.motion.epipolar_fit import Pose
from tisfm.motion.estimate import no_motion_status
from tisfm.motion.focal_evidence import FocalEvidence
from tisfm.motion.frame_agreement import aperture_status, replaced_status, unrelated_status
from tisfm.motion.homographies import resolve_plane
from tisfm.motion.light import LightChange, find_light_change
from tisfm.motion.problems import flow_problem
from tisfm.motion.settings import EGOMOTION, SPARSE
from tisfm.motion.sparse_motion import SparseMotion
from tisfm.motion.sparse_start import SparseStart, known_pose_start, sparse_start
from tisfm.rigid import KnownPose
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, coarse_to_fine
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import confidence
from tisfm.visibility.occlusion import leaves_image


@dataclass(frozen=True, kw_only=True)
class FirstMotion:
    """The motion that most of a flow field shows, or the pose that is known."""

    # rotation, translation: (3, 3) and (3,) float64: ‖t‖ = 1 unless t was given; t = 0 if no
    # translation is visible
    rotation: np.ndarray
    translation: np.ndarray
    # robust standard deviation of the displacements from epipolar lines, px of the finest level
    residual: float
    status: Status | None  # why there is no depth; None if there is depth
    # why the given pose may be wrong, why another motion is as likely, or why depth will be rough
    doubt: Status | None
    history: Records  # list of (level, warp, Iteration)
    flow: np.ndarray  # (h, w, 2) float32: the flow field, px of its level
    trust: np.ndarray  # (h, w) float32: its confidence
    level: int  # level of the flow field
    # whether matched points gave the motion; points are also matched between distant frames
    uses_matches: bool = False
    # whether the frames have one layout but different contents, so that matches are useless
    is_cut: bool = False
    light: tuple[LightChange, ...] = ()  # changes of light that were undone, in order
    # what the flow field or the matches say about the focal length; None if a pose is known
    focal_evidence: FocalEvidence | None = None

    @property
    def matrix(self) -> np.ndarray:
        """R and t, (3, 4)."""
        return np.column_stack([self.rotation, self.translation])


def first_motion(
    pyramid: ImagePyramid,
    settings: Settings,
    *,
    pose: KnownPose | None = None,  # the known motion; its translation, if any, is not 0
    # the coarsest level with at least as many pixels is used, by default the finest level
    min_pixels: float = math.inf,
    # whether points are matched: without a known pose if the flow field fits no motion well, with a
    # known translation if the flow field does not align the frames
    use_matches: bool = False,
    # (rotation, translation): the motion of a coarser level, ‖t‖ = 1, as the only start of the fit
    # to the flow field
    initial_pose: Pose | None = None,
    # (h, w) bool array: pixels of the level whose flow is not trusted, by default none
    hidden: np.ndarray | None = None,
    # whether a change of light is undone; False if this was done on a coarser level
    evens_light: bool = True,
) -> FirstMotion:
    """Fit a motion to the flow field of a level, or compare a known motion with it.

    If the light changed, the pyramid is modified in place: its frame 1 gets the light of frame 0.

    A known pose with a translation needs no parallax: with little parallax, depth is large or
    uncertain.
    """
    levels = [k for k, frame in enumerate(pyramid.frames0) if frame.size >= min_pixels]
    known_pose = pose or KnownPose(rotation=np.eye(3), translation=None)
    estimate_start = _estimate_in_even_light if evens_light else _estimate_flow_field
    start = estimate_start(pyramid, settings, known_pose, level=max(levels, default=0))
    if start.status is not None:
        return start
    if hidden is not None:
        start = replace(start, trust=np.where(hidden, 0, start.trust))
    scale, camera = pyramid.scales[start.level], pyramid.cameras[start.level]
    stripes = aperture_status(pyramid.frames0[start.level])
    if stripes is not None and known_pose.translation is None:
        return replace(start, status=stripes)
    try:
        fit = (
            camera_motion(start.flow, start.trust, camera)
            if initial_pose is None
            else refine_motion(start.flow, start.trust, camera, initial_pose)
        )
    except TooFewPixelsError as error:
        message = f"{error}: take sharper frames of more texture"
        return replace(start, status=Status("no_texture", message))
    frames = pyramid.frames0[start.level], pyramid.frames1[start.level]
    mismatch = unrelated_status(*frames, start.flow, start.trust)
    if (
        use_matches
        and pose is None
        and (mismatch is not None or fit.residual > EGOMOTION.max_flow_residual)
    ):
        flow_pose = (fit.rotation, fit.translation) if mismatch is None else None
        match_start = sparse_start(pyramid, start.level, flow_pose)
        # A flow field, if there is one, measures a small parallax better than matches.
        if match_start is not None and (
            mismatch is not None or _match_status(match_start.motion) is None
        ):
            return motion_from_matches(start, match_start)
    if use_matches and mismatch is not None and known_pose.translation is not None:
        length = float(np.linalg.norm(known_pose.translation))
        unit_pose = known_pose.rotation, known_pose.translation / length
        known_start, doubt = known_pose_start(pyramid, start.level, unit_pose)
        if known_start is not None and known_start.mismatch is None:
            # The images agree with the pose, although the flow field does not.
            return replace(
                start,
                residual=known_start.motion.residual,
                doubt=doubt,
                flow=known_start.flow,
                trust=known_start.trust,
                uses_matches=True,
            )
        if doubt is not None:
            return replace(start, status=doubt)
    median_flow = float(np.median(np.linalg.norm(start.flow, axis=-1))) / scale
    cut_status = None
    if mismatch is None and median_flow < EGOMOTION.max_still_flow_in_noise:
        cut_status = replaced_status(*frames, start.flow, hidden)
    if cut_status is not None:
        return replace(start, status=cut_status, is_cut=True)
    if mismatch is not None:
        return replace(start, status=mismatch)
    fit_residual = fit.residual / scale
    if known_pose.translation is not None:
        residual, inverse_pose_residual = (
            deviation_from_pose(start.flow, start.trust, camera, *motion) / scale
            for motion in _pose_and_inverse(known_pose.rotation, known_pose.translation)
        )
        # The flow of stripes is ambiguous, which is no reason to doubt a pose.
        doubt = (
            None
            if stripes
            else pose_status(residual, fit_residual, inverse_pose_residual=inverse_pose_residual)
        )
        return replace(start, residual=0.0 if stripes else residual, doubt=doubt)
    doubt = None
    if pose is not None:
        fit = camera_motion(start.flow, start.trust, camera, rotation=pose.rotation)
        doubt = pose_status(fit.residual / scale, fit_residual)
    status = _parallax_status(fit, scale, median_flow)
    if status == "uncertain":
        status, doubt = None, doubt or status
    motion = replace(
        start,
        residual=fit.residual / scale,
        status=None if status is None else doubt or status,
        doubt=doubt,
    )
    if status == "no_motion":
        return motion
    if status == "pure_rotation":
        return replace(motion, rotation=fit.rotation_alone)
    if pose is None and status is None:
        rays = sample_rays(start.flow, start.trust, camera)
        found_pose, plane = resolve_plane(rays, (fit.rotation, fit.translation), fit.residual)
        camera_doubt, focal_evidence = examine_camera(rays, found_pose, fit.rotation_alone)
        return replace(
            motion,
            rotation=found_pose[0],
            translation=found_pose[1],
            doubt=_strongest(camera_doubt, plane or doubt),
            focal_evidence=focal_evidence,
        )
    return replace(motion, rotation=fit.rotation, translation=fit.translation, doubt=doubt)


def _strongest(camera_doubt: Status | None, other: Status | None) -> Status | None:
    """Return the status to report: the most specific one that says how wrong the result is."""
    if camera_doubt == "uncertain":  # another doubt tells why the direction is hardly known
        return other or camera_doubt
    return camera_doubt or other


def motion_from_matches(start: FirstMotion, match_start: SparseStart) -> FirstMotion:
    """Return the first motion of matches, in place of the first motion of the flow field."""
    motion = match_start.motion
    status, doubt = match_start.mismatch or _match_status(motion), match_start.doubt
    if status == "uncertain":
        status, doubt = None, doubt or status
    is_rotation = status == "pure_rotation"
    focal_evidence = None
    if status is None and match_start.rays is not None:
        pose = motion.rotation, motion.translation
        camera_doubt, focal_evidence = examine_camera(match_start.rays, pose, motion.rotation_alone)
        doubt = _strongest(camera_doubt, doubt)
    return replace(
        start,
        rotation=motion.rotation_alone if is_rotation else motion.rotation,
        translation=np.zeros(3) if is_rotation else motion.translation,
        residual=motion.residual,
        status=status,
        doubt=doubt,
        flow=match_start.flow,
        trust=match_start.trust,
        uses_matches=True,
        focal_evidence=focal_evidence,
    )


def _match_status(motion: SparseMotion) -> Status | None:
    """Return the status of a motion from matches with too little parallax, None for others."""
    parallax, residual = motion.parallax, max(motion.residual, SPARSE.min_residual)
    measurement = _parallax_text(parallax, residual)
    if motion.model == "rotation":
        return _pure_rotation_status(measurement)
    if parallax >= EGOMOTION.good_parallax * residual:
        return None
    return (
        _uncertain_status(measurement)
        if parallax >= EGOMOTION.fair_parallax * residual
        else _little_parallax_status(measurement)
    )


def _parallax_text(parallax: float, residual: float) -> str:
    return (
        f"beyond a rotation, the image moves by {parallax:.2g} px, and noise is {residual:.2g} px"
    )


def _estimate_in_even_light(
    pyramid: ImagePyramid, settings: Settings, known_pose: KnownPose, *, level: int
) -> FirstMotion:
    """Return the flow field of a level; bring frame 1 to the light of frame 0 first if it changed.

    The pyramid is modified in place. A flow field tells a change of light only if its constraints
    include the gradient, which light hardly changes.
    """
    start = _estimate_flow_field(pyramid, settings, known_pose, level=level)
    if settings.gradient == 0 or start.status is not None:
        return start
    change = find_light_change(
        pyramid.frames0[level], pyramid.frames1[level], start.flow, start.trust
    )
    # the search for objects allows for small changes of light, so that they are no objects
    if change is None or (settings.motion == "objects" and not change.is_large):
        return start
    frames = pyramid.frames0[level], pyramid.frames1[level]
    if unrelated_status(*frames, start.flow, start.trust) is not None:  # the flow is wrong
        return start
    given_frames1, given_start = pyramid.frames1, start
    pyramid.set_frames1([change.undo(frame) for frame in given_frames1])
    if not change.is_large:
        return replace(start, light=(change,))
    start = _estimate_flow_field(pyramid, settings, known_pose, level=level)
    rest = find_light_change(
        pyramid.frames0[level], pyramid.frames1[level], start.flow, start.trust
    )
    if rest is None:
        return replace(start, light=(change,))
    if change.remains(rest):  # the flow was wrong
        pyramid.set_frames1(given_frames1)
        return given_start
    pyramid.set_frames1([rest.undo(frame) for frame in pyramid.frames1])
    return replace(start, light=(change, rest))


def _estimate_flow_field(
    pyramid: ImagePyramid, settings: Settings, known_pose: KnownPose, *, level: int
) -> FirstMotion:
    """Return the flow field of a level, with the given motion."""
    settings = replace(settings, warps=max(settings.warps, EGOMOTION.min_warps))
    problem = flow_problem(settings, pyramid.cameras[0].focal)
    solution = coarse_to_fine(pyramid, problem, last=level)
    flow = solution.unknowns.flow()
    with np.errstate(over="ignore", invalid="ignore"):  # where the field diverged
        hidden = leaves_image(flow)
        if pyramid.masks is not None:
            hidden |= pyramid.masks.ignored_pixels(flow, level)
        trust = confidence(
            solution.unknowns.precision(solution.system),
            hidden,
            normalized=settings.normalization is not None,
        )
    return FirstMotion(
        rotation=known_pose.rotation,
        translation=np.zeros(3) if known_pose.translation is None else known_pose.translation,
        residual=0.0,
        status=no_motion_status(solution, is_textured=pyramid.contrast > 0),
        doubt=None,
        history=solution.history,
        flow=np.moveaxis(flow, 0, -1),
        trust=trust,
        level=level,
    )


def _pose_and_inverse(rotation: np.ndarray, translation: np.ndarray) -> tuple[Pose, Pose]:
    """Return a motion and its inverse."""
    return (rotation, translation), (rotation.T, -rotation.T @ translation)


def _parallax_status(fit: CameraMotion, scale: float, median_flow: float) -> Status | None:
    """Return the status of a flow with too little parallax, None for others.

    Lengths of `fit` are in px of its level.
    """
    parallax, residual = fit.parallax / scale, max(fit.residual, EGOMOTION.min_residual) / scale
    ratio = parallax / residual
    if ratio >= (EGOMOTION.good_parallax if parallax >= 1 else EGOMOTION.good_subpixel_parallax):
        return None
    measurement = _parallax_text(parallax, residual)
    if ratio >= EGOMOTION.fair_parallax:
        return _uncertain_status(measurement)
    if ratio >= EGOMOTION.min_parallax:
        return _little_parallax_status(measurement)
    if median_flow < max(EGOMOTION.max_still_flow, 3 * residual):
        return Status(
            "no_motion",
            f"too little parallax for depth: the image moves by {median_flow:.2g} px, no more than "
            "noise; take frames farther apart in time",
        )
    return _pure_rotation_status(measurement)


def _uncertain_status(measurement: str) -> Status:
    return Status(
        "uncertain",
        f"there is little parallax, so depth is rough: {measurement}; take frames farther apart, "
        "or move the camera sideways",
    )


def _little_parallax_status(measurement: str) -> Status:
    return Status(
        "little_parallax",
        f"too little parallax for depth: {measurement}; take frames farther apart, or move the "
        "camera sideways",
    )


def _pure_rotation_status(measurement: str) -> Status:
    return Status(
        "pure_rotation",
        f"too little parallax for depth: the camera only rotated ({measurement}); move the camera "
        "between frames",
    )
