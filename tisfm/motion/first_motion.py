"""The motion that most of a flow field shows: where ``"camera"`` and ``"objects"`` start."""

import math
from dataclasses import dataclass, replace

import numpy as np

from tisfm.motion.depth_checks import pose_status
from tisfm.motion.egomotion import (
    CameraMotion,
    TooFewPixelsError,
    camera_motion,
    correspondences,
    distance_from_rays,
    refined_motion,
)
from tisfm.motion.epipolar_fit import Pose
from tisfm.motion.estimate import unmoved
from tisfm.motion.frame_agreement import aperture_status, replaced, unrelated
from tisfm.motion.plane_ambiguity import plane_status
from tisfm.motion.problems import flow_problem
from tisfm.motion.sparse_motion import SMALLEST_RESIDUAL, SparseMotion
from tisfm.motion.sparse_start import SparseStart, posed_start, sparse_start
from tisfm.rigid import KnownPose
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, coarse_to_fine
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import confidence
from tisfm.visibility.occlusion import leaves_image

LEAST_WARPS = 2  # linearisations on the level of the flow field
# Parallax over the residual of the fit, from which on there is depth. Noise alone gives 2 where the
# camera only turned. On hand-held sequences, depth with less than `ENOUGH` was little better than a
# constant: errors of lens and shutter exceed a parallax below a pixel, and the residual does not
# show them. From `ROUGH` on, depth was better than a constant in most pairs.
SEEN = 2.5
ROUGH = 4.0
ENOUGH = 6.0
ENOUGH_BELOW_A_PIXEL = 9.0  # the same if the parallax is less than 1 px
FINEST_RESIDUAL = 0.005  # px of the level: least error of a flow; set by hand
# px of the level: residual of a fit above which points are matched. At most 0.045 on rendered
# scenes and in a textured studio; from 0.065 on in rooms with bare walls and between frames far
# apart, where directions were off by degrees.
POOR_RESIDUAL = 0.06
STILL = 0.1  # px: largest median flow of a camera at rest
STILL_IN_NOISE = 0.3  # px: the same in noisy frames


@dataclass(frozen=True, kw_only=True)
class FirstMotion:
    """The motion that most of a flow field shows, or the pose that is known."""

    # rotation, translation: (3, 3) and (3,) float64: ‖t‖ = 1 unless it was given, or 0 where none
    # is seen
    rotation: np.ndarray
    translation: np.ndarray
    # robust standard deviation of the displacements from epipolar lines, px of the finest level
    residual: float
    status: Status | None  # why there is no depth; None if there is
    # why the given pose may be wrong, why another motion is as likely, or why depth will be rough
    doubt: Status | None
    history: Records  # list of (level, warp, Iteration)
    flow: np.ndarray  # (h, w, 2) float32: the flow field, px of its level
    trust: np.ndarray  # (h, w) float32: its confidence
    level: int  # of the flow field
    # whether the motion is that of matched points, which works for frames far apart, too
    matched: bool = False
    # whether the frames are two pictures of one layout, so that matching points is useless
    is_cut: bool = False

    @property
    def matrix(self) -> np.ndarray:
        """R and t, (3, 4)."""
        return np.column_stack([self.rotation, self.translation])


def first_motion(
    pyramid: ImagePyramid,
    settings: Settings,
    *,
    pose: KnownPose | None = None,  # the known motion; its translation, if any, is not 0
    # the coarsest level with at least as many pixels is taken, by default the finest
    pixels: float = math.inf,
    # whether points are matched if the flow field fits no motion well and no pose is known, or if
    # it does not align the frames and a pose with translation is known
    matches: bool = False,
    # (rotation, translation): the motion of a coarser level, ‖t‖ = 1, that the fit to the flow
    # field starts from alone
    coarser: Pose | None = None,
    # (h, w) bool array: pixels of the level whose flow is not trusted, by default none
    unseen: np.ndarray | None = None,
) -> FirstMotion:
    """Fit a motion to the flow field of a level, or judge a known one by it.

    A known pose with a translation needs no parallax: with little parallax, depth is large or
    uncertain.
    """
    large = [k for k, frame in enumerate(pyramid.frames0) if frame.size >= pixels]
    given = pose or KnownPose(rotation=np.eye(3), translation=None)
    start = _flow_field(pyramid, settings, given, level=max(large, default=0))
    if start.status is not None:
        return start
    if unseen is not None:
        start = replace(start, trust=np.where(unseen, 0, start.trust))
    scale, camera = pyramid.scales[start.level], pyramid.cameras[start.level]
    stripes = aperture_status(pyramid.frames0[start.level])
    if stripes is not None and given.translation is None:
        return replace(start, status=stripes)
    try:
        found = (
            camera_motion(start.flow, start.trust, camera)
            if coarser is None
            else refined_motion(start.flow, start.trust, camera, coarser)
        )
    except TooFewPixelsError as error:
        message = f"{error}: take sharper frames of more texture"
        return replace(start, status=Status("no_texture", message))
    frames = pyramid.frames0[start.level], pyramid.frames1[start.level]
    apart = unrelated(*frames, start.flow, start.trust)
    if matches and pose is None and (apart is not None or found.residual > POOR_RESIDUAL):
        dense = (found.rotation, found.translation) if apart is None else None
        far = sparse_start(pyramid, start.level, dense)
        # A flow field, if there is one, measures a small parallax better than matches.
        if far is not None and (apart is not None or _matched_status(far.motion) is None):
            return matched_motion(start, far)
    if matches and apart is not None and given.translation is not None:
        length = float(np.linalg.norm(given.translation))
        unit = given.rotation, given.translation / length
        posed, doubt = posed_start(pyramid, start.level, unit)
        if posed is not None and posed.apart is None:
            # The images agree with the pose, although the flow field does not.
            return replace(
                start,
                residual=posed.motion.residual,
                doubt=doubt,
                flow=posed.flow,
                trust=posed.trust,
                matched=True,
            )
        if doubt is not None:
            return replace(start, status=doubt)
    moved = float(np.median(np.linalg.norm(start.flow, axis=-1))) / scale
    cut = None
    if apart is None and moved < STILL_IN_NOISE:
        cut = replaced(*frames, start.flow, unseen)
    if cut is not None:
        return replace(start, status=cut, is_cut=True)
    if apart is not None:
        return replace(start, status=apart)
    best = found.residual / scale
    if given.translation is not None:
        off, back = (
            distance_from_rays(start.flow, start.trust, camera, *motion) / scale
            for motion in _with_inverse(given.rotation, given.translation)
        )
        # The flow of stripes is ambiguous: it is no reason to doubt a pose.
        doubt = None if stripes else pose_status(off, best, inverse=back)
        return replace(start, residual=0.0 if stripes else off, doubt=doubt)
    doubt = None
    if pose is not None:
        found = camera_motion(start.flow, start.trust, camera, rotation=pose.rotation)
        doubt = pose_status(found.residual / scale, best)
    status = _parallax_status(found, scale, moved)
    if status == "uncertain":
        status, doubt = None, doubt or status
    known = replace(
        start,
        residual=found.residual / scale,
        status=None if status is None else doubt or status,
        doubt=doubt,
    )
    if status == "no_motion":
        return known
    if status == "pure_rotation":
        return replace(known, rotation=found.rotation_alone)
    if pose is None and status is None:
        plane = plane_status(correspondences(start.flow, start.trust, camera), found.residual)
        doubt = plane or doubt
    return replace(known, rotation=found.rotation, translation=found.translation, doubt=doubt)


def matched_motion(start: FirstMotion, far: SparseStart) -> FirstMotion:
    """Return the first motion that follows from matches, in place of that of the flow field."""
    motion = far.motion
    status, doubt = far.apart or _matched_status(motion), far.doubt
    if status == "uncertain":
        status, doubt = None, doubt or status
    turned = status == "pure_rotation"
    return replace(
        start,
        rotation=motion.rotation_alone if turned else motion.rotation,
        translation=np.zeros(3) if turned else motion.translation,
        residual=motion.residual,
        status=status,
        doubt=doubt,
        flow=far.flow,
        trust=far.trust,
        matched=True,
    )


def _matched_status(motion: SparseMotion) -> Status | None:
    """Return the status of a motion from matches with too little parallax, None for others."""
    parallax, residual = motion.parallax, max(motion.residual, SMALLEST_RESIDUAL)
    seen = f"beyond a rotation, the image moves by {parallax:.2g} px, noise is {residual:.2g} px"
    if motion.model == "rotation":
        return _turned_only(seen)
    if parallax >= ENOUGH * residual:
        return None
    return _rough(seen) if parallax >= ROUGH * residual else _hardly_moved(seen)


def _flow_field(
    pyramid: ImagePyramid, settings: Settings, given: KnownPose, *, level: int
) -> FirstMotion:
    """Return the flow field of a level, with the given motion."""
    settings = replace(settings, warps=max(settings.warps, LEAST_WARPS))
    problem = flow_problem(settings, pyramid.cameras[0].focal)
    solution = coarse_to_fine(pyramid, problem, last=level)
    flow = solution.unknowns.flow()
    with np.errstate(over="ignore", invalid="ignore"):  # where the field diverged
        unseen = leaves_image(flow)
        if pyramid.counted is not None:
            unseen |= pyramid.counted.missing(flow, level)
        trust = confidence(
            solution.unknowns.precision(solution.system),
            unseen,
            normalized=settings.normalization is not None,
        )
    return FirstMotion(
        rotation=given.rotation,
        translation=np.zeros(3) if given.translation is None else given.translation,
        residual=0.0,
        status=unmoved(solution, textured=pyramid.contrast > 0),
        doubt=None,
        history=solution.history,
        flow=np.moveaxis(flow, 0, -1),
        trust=trust,
        level=level,
    )


def _with_inverse(rotation: np.ndarray, translation: np.ndarray) -> tuple[Pose, Pose]:
    """Return a motion and its inverse."""
    return (rotation, translation), (rotation.T, -rotation.T @ translation)


def _parallax_status(found: CameraMotion, scale: float, moved: float) -> Status | None:
    """Return the status of a flow with too little parallax, None for others.

    Lengths of `found` are in px of its level.
    """
    parallax, residual = found.parallax / scale, max(found.residual, FINEST_RESIDUAL) / scale
    share = parallax / residual
    if share >= (ENOUGH if parallax >= 1 else ENOUGH_BELOW_A_PIXEL):
        return None
    seen = f"beyond a rotation, the image moves by {parallax:.2g} px, noise is {residual:.2g} px"
    if share >= ROUGH:
        return _rough(seen)
    if share >= SEEN:
        return _hardly_moved(seen)
    if moved < max(STILL, 3 * residual):
        return Status(
            "no_motion",
            f"too little parallax for depth: the image moves by {moved:.2g} px, no more than "
            "noise; take frames further apart in time",
        )
    return _turned_only(seen)


def _rough(seen: str) -> Status:
    return Status(
        "uncertain",
        f"there is little parallax, so depth is rough: {seen}; take frames further apart, or move "
        "the camera sideways",
    )


def _hardly_moved(seen: str) -> Status:
    return Status(
        "little_parallax",
        f"too little parallax for depth: {seen}; take frames further apart, or move the "
        "camera sideways",
    )


def _turned_only(seen: str) -> Status:
    return Status(
        "pure_rotation",
        f"too little parallax for depth: the camera only turned. {seen[0].upper()}{seen[1:]}; move "
        "the camera",
    )
