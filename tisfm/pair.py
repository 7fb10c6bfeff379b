"""The interpretation of a pair of frames."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera, check_camera
from tisfm.errors import InputError
from tisfm.formats.packing import STEP, round_as_packed
from tisfm.frames import check_frame
from tisfm.interpretation import Interpretation
from tisfm.prepared_pair import ignored_pixels, prepare_pair
from tisfm.rigid import check_pose
from tisfm.settings import FixedPixels, FocalOrigin, Settings, check_fixed_pixels, check_settings
from tisfm.status import History, Status
from tisfm.version import __version__
from tisfm.visibility.confidence import confidence
from tisfm.visibility.occlusion import leaves_image, pyramid_occlusion
from tisfm.window import Window

if TYPE_CHECKING:
    from tisfm.solver.image_pyramid import ImagePyramid

ENERGY_OVERFLOW = Status(
    "diverged",
    "the energy grew beyond what single precision can hold: bring the frames to the 8-bit scale",
)
USABLE_STATUSES = ("converged", "iteration_limit")  # statuses of a flow that the next pair may use


def interpret(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    pose: npt.ArrayLike | None = None,
    mask: npt.ArrayLike | None = None,
    fixed_pixels: FixedPixels = "mask",
) -> Interpretation:
    """Interpret two frames: 3D motion, depth and image motion at every pixel of frame 0.

    Parameters
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) array
        Grey or RGB; uint8, uint16 or float, the same type for both. At least 4 × 4 px. Not
        modified. Float frames are assumed to be in [0, 1] if 80% of the values of each lie in
        [−0.01, 1.01], 99% in [−1, 2], and 99.9% in [−10, 11]: resampling and sharpening may
        overshoot, and some pixels may be wrong. Other float frames are assumed to be on the 8-bit
        scale, whatever their range. A very dark frame on the 8-bit scale may meet the conditions
        for [0, 1] too: give it as uint8.
    camera : Camera, optional
        By default the principal point is the centre of the image. The default focal length is
        600 px for ``motion="field"``, as in the paper; for the other motion models, whose depth
        depends on it, it is 1.2 times the longer side of the image, with a `GuessedFocalWarning`.
        For ``motion="camera"``, a focal length that the image motion shows replaces this guess.
        If the camera has distortion or oblong pixels, both frames are resampled first, and the
        result belongs to frame 0 without distortion and with square pixels, of the same size,
        focal length and centre. If the camera states a readout, as a share of the time from frame
        0 to frame 1, and the motion is ``"camera"``, the rolling shutter is undone: the result
        belongs to frames whose rows were all read with the middle row. The camera is assumed to
        move evenly between the two.
    settings : Settings, optional
        By default the preset ``"balanced"``.
    pose : (4, 4) or (3, 3) array, optional
        A known motion, for ``motion="camera"``. Either (R, t; 0, 1), which takes points from frame
        0's camera axes to frame 1's, P₁ = R P₀ + t: depth then has the unit of t. Or R alone: the
        direction of the translation is then estimated. With t, pixels without parallax are
        taken as far away: their inverse depth is near 0, compared with its standard deviation. Only
        identical frames then get no depth.
        If a rolling shutter is undone, the pose is that between the middle rows.
    mask : (H, W) or (2, H, W) array, optional
        Pixels to use, for both frames or for each; black, zero or False pixels are ignored, for
        example bonnets, logos and mattes. By default all are used.

    fixed_pixels : {"mask", "keep"}
        Whether pixels that are fixed on the sensor although the camera moves, such as a bonnet or a
        logo, are found and ignored as by `mask` (``motion="camera"``, for a camera without
        distortion and readout). The message of the status says so.

    Returns
    -------
    Interpretation
        Its `camera` is a pinhole. Where the frames without distortion have no data, confidence is
        0 and `occlusion` True. The same holds for pixels that are ignored in frame 0, or that move
        to ignored pixels of frame 1: their values come from the neighbourhood, and the deviation
        of their inverse depth is infinite. If a rolling shutter was undone, the readout of
        `camera` is 0, and all maps belong to `frame`, which is frame 0 with all rows read with the
        middle row: depth, points and motion need a single camera position. The flow leads to
        frame 1 with all rows read with its middle row. If the frames show no motion with which to
        undo the rolling shutter, all maps belong to frame 0 as given, and `camera` keeps its
        readout.

    Raises
    ------
    TypeError, ValueError
        If a frame is not an image of these types, the two differ in size or type, or a pixel is
        masked, NaN, infinite or beyond 1e36; if `pose` is not one of these matrices, turns by 90°
        or more, has a translation whose length is neither 0 nor from 1e-30 to 1e30, or is given
        for a motion that is not ``"camera"``; if `fixed_pixels` is another word; if almost no pixel
        of the frames has data without distortion; if `mask` does not have the size of the frames,
        or excludes all pixels of one.

    Notes
    -----
    Beyond grey levels of 1e15, squares of derivatives overflow: the status is ``"diverged"`` then.

    References
    ----------
    Sekkati, Mitiche, "A variational method for the recovery of dense 3D structure from motion",
    Robotics and Autonomous Systems 55 (2007) 597–607, doi 10.1016/j.robot.2006.11.006.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import static_scene
    >>> scene = static_scene("forward", 96, 128)  # or read_image of two files
    >>> settings = tisfm.Settings.preset("fast", motion="camera")
    >>> result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    >>> str(result.status)
    'converged'
    >>> from tisfm.metrics import depth_errors
    >>> depth_errors(result.depth, scene.depth).abs_rel < 0.1  # its scale brought to the true one
    True

    Frames without motion have a status that says so, and no depth:

    >>> still = tisfm.interpret(scene.frame0, scene.frame0, camera=scene.camera, settings=settings)
    >>> str(still.status)
    'no_motion'
    """
    check_fixed_pixels(fixed_pixels)
    ignored = None
    if mask is not None:
        ignored = ignored_pixels(mask, check_frame(frame0, "frame0").shape[:2])
    return interpret_pair(
        frame0,
        frame1,
        camera=camera,
        settings=settings,
        pose=pose,
        ignored=ignored,
        fixed_pixels=fixed_pixels,
    )


def interpret_pair(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    pose: npt.ArrayLike | None = None,
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None = None,
    scales_unit_range: bool = True,
    window: Window | None = None,
    fixed_pixels: FixedPixels = "mask",
    focal_origin: FocalOrigin | None = None,
) -> Interpretation:
    """Interpret a pair of a sequence, as `interpret` does.

    `ignored`, (H, W) bool, marks the pixels of each frame that are not used; None to use all.
    `scales_unit_range` says whether float frames in [0, 1] are brought to the 8-bit scale
    (`tisfm.frames.grey_pair`). `window`, for motion ``"field"``, holds the previous pair; this pair
    then replaces it there. `focal_origin` says where the focal length of `camera` comes from; by
    default it is stated, or guessed without a camera.
    """
    settings = check_settings(settings)
    if focal_origin is None:
        focal_origin = "guessed" if camera is None else "stated"
    known_pose = check_pose(pose)
    if known_pose is not None and settings.motion != "camera":
        raise InputError(
            f'pose is given, but motion="{settings.motion}" leaves the motion free: leave it out'
        )
    prepared_pair = prepare_pair(
        frame0,
        frame1,
        camera=camera,
        settings=settings,
        ignored=ignored,
        scales_unit_range=scales_unit_range,
        known_pose=known_pose,
    )
    pyramid, lens = prepared_pair.pyramid, prepared_pair.lens
    from tisfm.motion.camera import camera_estimate
    from tisfm.motion.depth_checks import depth_status, with_brightness_advice
    from tisfm.motion.estimate import history_of
    from tisfm.motion.field import field_estimate
    from tisfm.motion.fixed_pixels import resize_mask, with_fixed_note
    from tisfm.motion.focal_evidence import with_focal_note
    from tisfm.motion.frame_agreement import confirms_large_motion, diverged_status, field_status
    from tisfm.motion.light import with_light_note
    from tisfm.motion.objects.estimation import objects_estimate
    from tisfm.motion.previous_frame import previous_frame

    previous = None
    if settings.motion == "field":
        previous = previous_frame(pyramid, settings, None if window is None else window.previous)
        estimate = field_estimate(pyramid, settings, previous)
    elif settings.motion == "camera":
        given_camera = check_camera(camera)
        is_plain = given_camera.is_pinhole and not given_camera.readout
        finds_fixed_pixels = fixed_pixels == "mask" and is_plain
        estimate = camera_estimate(
            pyramid,
            settings,
            known_pose,
            finds_fixed_pixels=finds_fixed_pixels,
            finds_focal=camera is None,
        )
        if estimate.fixed_pixels is not None:
            fixed = resize_mask(estimate.fixed_pixels, pyramid.shape)
            result = interpret_pair(
                frame0,
                frame1,
                camera=camera,
                settings=settings,
                pose=pose,
                ignored=_with_ignored(ignored, fixed),
                scales_unit_range=scales_unit_range,
                fixed_pixels="keep",
                focal_origin=focal_origin,
            )
            return replace(result, status=with_fixed_note(result.status, fixed))
        evidence = estimate.focal_evidence
        if camera is None and evidence is not None and evidence.replaces_guess:
            guess = prepared_pair.camera
            result = interpret_pair(
                frame0,
                frame1,
                camera=replace(guess, focal=guess.focal * math.exp(evidence.value)),
                settings=settings,
                pose=pose,
                ignored=ignored,
                scales_unit_range=scales_unit_range,
                fixed_pixels=fixed_pixels,
                focal_origin="estimated",
            )
            return replace(
                result,
                status=with_focal_note(result.status, result.camera.focal, evidence),
                focal_deviation=math.inf,
            )
    else:
        estimate = objects_estimate(pyramid, settings, *prepared_pair.greys)
    flow, deviation = estimate.flow, estimate.inverse_depth_std
    if pyramid.contrast == 0:
        estimate.precision[...] = 0  # frame 0 is uniform: the frames show no motion
    with np.errstate(over="ignore", invalid="ignore"):  # ρ̂ may have diverged: the status says so
        is_leaving = leaves_image(flow)
        occluded = pyramid_occlusion(
            pyramid,
            flow,
            settings,
            is_leaving=is_leaving,
            level=estimate.level,
            residual=None if previous is None or pyramid.last > 0 else previous.residual,
        )
        if lens is not None:
            occluded |= lens.pixels_without_data(flow)
        if deviation is not None:
            deviation[occluded] = np.inf
        pixel_confidence = confidence(
            estimate.precision,
            occluded,
            normalized=estimate.is_normalized,
            freedom=estimate.freedom,
        )
    history, is_finite = _finite_history(history_of(estimate.history))
    status = estimate.status
    has_known_translation = known_pose is not None and known_pose.translation is not None
    if status != "pose_mismatch":  # a wrong pose is the more likely reason for a wrong flow
        is_confirmed = estimate.uses_matches or has_known_translation
        divergence = diverged_status(flow, is_leaving, is_confirmed=is_confirmed)
        if (
            divergence is not None
            and not is_confirmed
            and confirms_large_motion(pyramid, flow, occluded)
        ):
            divergence = diverged_status(flow, is_leaving, is_confirmed=True)
        status = prepared_pair.overflow or divergence or (status if is_finite else ENERGY_OVERFLOW)
    if status in ("converged", "iteration_limit", "uncertain"):
        if settings.motion == "field":
            status = field_status(pyramid, flow, pixel_confidence) or status
        elif estimate.start_flow is not None:
            depth_doubt = depth_status(pyramid, estimate, occluded)
            # If both statuses are "uncertain", the estimate's own message is more specific.
            if depth_doubt is not None and depth_doubt != status:
                status = depth_doubt
    status = with_brightness_advice(status, pyramid, settings)
    status = with_light_note(status, estimate.light)
    if (evidence := estimate.focal_evidence) is not None:
        status = evidence.add_note(status, focal_origin)
    if window is not None:
        _store_pair(window, pyramid, flow, occluded, status)
        if window.previous is None and previous is not None and previous.is_used:
            return interpret_pair(  # without the previous pair
                frame0,
                frame1,
                camera=camera,
                settings=settings,
                ignored=ignored,
                scales_unit_range=scales_unit_range,
                window=window,
            )
    return Interpretation(
        rho=estimate.rho,
        flow=cv2.merge(list(flow)),  # several times as fast as a transposed copy
        inverse_depth=estimate.inverse_depth,
        inverse_depth_std=deviation,
        confidence=pixel_confidence,
        occlusion=occluded,
        motions=estimate.motions,
        labels=estimate.labels,
        frame=prepared_pair.frame,
        camera=prepared_pair.camera,
        settings=settings,
        status=status,
        history=history,
        version=__version__,
        focal_deviation=math.inf if camera is None and settings.motion != "field" else 0.0,
        focal_effect=math.nan if evidence is None else evidence.depth_effect,
        focal_spread=math.nan if evidence is None else evidence.spread,
    )


def _with_ignored(
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None, fixed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ignored pixels of both frames with fixed pixels, (H, W) bool."""
    first, second = (None, None) if ignored is None else ignored
    return (
        fixed if first is None else first | fixed,
        fixed if second is None else second | fixed,
    )


def store_pair(
    window: Window,
    result: Interpretation,
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None,
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None = None,
    scales_unit_range: bool = True,
) -> None:
    """Store a finished pair in `window` for the next pair, as `interpret_pair` does.

    `result` is the result of `interpret_pair` for the other arguments.
    """
    prepared_pair = prepare_pair(
        frame0,
        frame1,
        camera=camera,
        settings=result.settings,
        ignored=ignored,
        scales_unit_range=scales_unit_range,
    )
    flow = np.stack(cv2.split(result.flow))
    _store_pair(window, prepared_pair.pyramid, flow, result.occlusion, result.status)


def _store_pair(
    window: Window, pyramid: "ImagePyramid", flow: np.ndarray, occluded: np.ndarray, status: Status
) -> None:
    """Store a flow, (2, H, W), for the next pair, if its status is in `USABLE_STATUSES`.

    The flow is rounded as in a compact file, so that a resumed run, which reads the flow from such
    a file, gives the same results.
    """
    from tisfm.motion.previous_frame import PreviousPair

    is_reliable = status in USABLE_STATUSES
    window.previous = (
        PreviousPair.from_pair(pyramid, round_as_packed(flow, STEP), occluded)
        if is_reliable
        else None
    )


def _finite_history(history: History) -> tuple[History, bool]:
    """Return a history without iterations of infinite energy, and whether all were finite.

    An energy is infinite if single precision cannot hold it.
    """
    is_finite = np.logical_and.reduce([np.isfinite(record) for record in vars(history).values()])
    if is_finite.all():
        return history, True
    return History(**{name: record[is_finite] for name, record in vars(history).items()}), False
