"""Two frames in, one interpretation out."""

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from tisfm import runtime
from tisfm.camera import Camera, check_camera
from tisfm.checks import unmasked_mask
from tisfm.errors import InputError, InputTypeError
from tisfm.focal_guess import guess_camera
from tisfm.formats.packing import STEP, round_as_packed
from tisfm.frames import check_frame, eight_bit, grey_pair
from tisfm.interpretation import Interpretation
from tisfm.lens import Undistortion
from tisfm.rigid import KnownPose, check_pose
from tisfm.settings import Settings, check_settings
from tisfm.solver.pixel_masks import filled
from tisfm.status import History, Status
from tisfm.version import __version__
from tisfm.visibility.confidence import confidence
from tisfm.visibility.occlusion import leaves_image, occlusion_in
from tisfm.window import Window

if TYPE_CHECKING:
    from tisfm.solver.image_pyramid import ImagePyramid

RUNAWAY = 0.5  # of the image's longer side: benchmarks have at most 0.12, runaway flow 0.7 and more
LARGEST_SQUARED = 1e15  # grey levels: squares of derivatives have to be numbers of float32
UNCOUNTED = Status(
    "diverged",
    "the energy grew beyond what single precision can hold: bring the frames to the 8-bit scale",
)
RELIABLE = ("converged", "iteration_limit")  # statuses of a flow that the next pair may rely on
MOST_LEAVING = 0.5  # of the pixels: benchmarks have at most 0.08
# The same for frames far apart whose motion is confirmed by matched points, a pose or the images:
# near objects cross the whole image, and after a turn by 20° two thirds of the pixels had left it.
RUNAWAY_VOUCHED, MOST_LEAVING_VOUCHED = 1.0, 0.8


def interpret(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    pose: npt.ArrayLike | None = None,
    mask: npt.ArrayLike | None = None,
) -> Interpretation:
    """Interpret two frames: 3D motion, depth and image motion at every pixel of frame 0.

    Parameters
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) array
        Grey or RGB; uint8, uint16 or float, both alike. At least 4 × 4 px. Not modified.
        Float frames are taken to be in [0, 1] if, of the values of each, 80% lie in [−0.01, 1.01],
        99% in [−1, 2], and 99.9% in [−10, 11], so that resampling and sharpening may overshoot and
        some pixels may be wrong. Otherwise they are taken to be on the 8-bit scale, whatever their
        range. Frames on that scale so dark that they meet this are taken to be in [0, 1] as well:
        give them as uint8.
    camera : Camera, optional
        By default the image's centre and a focal length of 600 px, as in the paper, or, because
        depth depends on it there, 1.2 times the image's longer side for ``motion="camera"``, with
        a `GuessedFocalWarning`. If it has distortion or oblong pixels, both frames are resampled
        first, and the result is that of frame 0 without distortion and with square pixels, of
        the same size, focal length and centre. Likewise, if it states a readout, a share of the
        time from frame 0 to frame 1, and the motion is ``"camera"``: the result is that of both
        frames as their middle rows saw them, between which the camera is taken to move evenly.
    settings : Settings, optional
        By default the preset ``"balanced"``.
    pose : (4, 4) or (3, 3) array, optional
        A known motion, for ``motion="camera"``: points in frame 0's camera axes to frame 1's, P₁ =
        R P₀ + t, which makes depth one in the unit of t; or R alone, which leaves the direction
        of translation to be found. With t, what shows no parallax is far, its inverse depth 0
        within the deviation; only frames that are identical have no depth. Where a readout is
        undone, it is that of middle rows.
    mask : (H, W) or (2, H, W) array, optional
        Pixels that count, in both frames, or in each of them; black, zero or False are ignored, as
        bonnets, logos and mattes should be. By default all count.

    Returns
    -------
    Interpretation
        Its `camera` is a pinhole. Where the frames without distortion have no data, confidence is
        0 and `occlusion` True. So they are where pixels are ignored in frame 0, or go to pixels
        that are ignored in frame 1: what they have there is carried from around, and its deviation
        is infinite. Where a readout was undone, `camera` has the readout 0, and all belongs to
        `frame`, which is frame 0 as its middle row saw it: depth, points and motion need one place
        of the camera. Its flow leads to frame 1 as that one's middle row saw it. Where frames
        show no motion to undo it by, all belongs to frame 0 as given, and the readout stays.

    Raises
    ------
    TypeError, ValueError
        If a frame is not an image of those kinds, the two differ in size or type, or a pixel is
        masked, NaN, infinite or beyond 1e36; if `pose` is not one of these, turns by 90° or more,
        has a translation whose length is neither 0 nor from 1e-30 to 1e30, or is given for a
        motion that is not ``"camera"``; if distortion leaves next to nothing of the frames; if
        `mask` is not of the size of the frames, or leaves nothing of one of them.

    Notes
    -----
    Beyond 1e15 squares of derivatives overflow: the status is ``"diverged"`` then.

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
    ignored = None
    if mask is not None:
        ignored = _ignored(mask, check_frame(frame0, "frame0").shape[:2])
    return interpret_pair(
        frame0, frame1, camera=camera, settings=settings, pose=pose, ignored=ignored
    )


def interpret_pair(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    pose: npt.ArrayLike | None = None,
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None = None,
    stretch: bool = True,
    window: Window | None = None,
) -> Interpretation:
    """Do what `interpret` does, for a pair of a sequence.

    `ignored`, (H, W) bool, are the pixels of each frame that do not count, None for none of them.
    `stretch` says whether float frames in [0, 1] are brought to the 8-bit scale
    (`tisfm.frames.grey_pair`). `window` holds what is known of the pair before, for motion
    ``"field"``, and then what the next one may take from this pair.
    """
    settings = check_settings(settings)
    known = check_pose(pose)
    if known is not None and settings.motion != "camera":
        raise InputError(
            f'pose is given, but motion="{settings.motion}" leaves the motion free: leave it out'
        )
    taken = _taken(
        frame0,
        frame1,
        camera=camera,
        settings=settings,
        ignored=ignored,
        stretch=stretch,
        known=known,
    )
    pyramid, lens = taken.pyramid, taken.lens
    from tisfm.motion.camera import camera_estimate
    from tisfm.motion.depth_checks import depth_status, with_brightness_advice
    from tisfm.motion.estimate import history_of
    from tisfm.motion.field import field_estimate
    from tisfm.motion.frame_agreement import confirms_large_motion, field_status
    from tisfm.motion.objects.estimation import objects_estimate
    from tisfm.motion.previous_frame import previous_frame

    before = None
    if settings.motion == "field":
        before = previous_frame(pyramid, settings, None if window is None else window.previous)
        estimate = field_estimate(pyramid, settings, before)
    elif settings.motion == "camera":
        estimate = camera_estimate(pyramid, settings, known)
    else:
        estimate = objects_estimate(pyramid, settings, *taken.greys)
    flow, deviation = estimate.flow, estimate.inverse_depth_std
    if pyramid.contrast == 0:
        estimate.precision[...] = 0  # it is of gradients of frame 1 alone
    with np.errstate(over="ignore", invalid="ignore"):  # where ρ̂ diverged, as the status says
        leaves = leaves_image(flow)
        unseen = occlusion_in(
            pyramid,
            flow,
            settings,
            leaves=leaves,
            level=estimate.level,
            residual=None if before is None or pyramid.last > 0 else before.residual,
        )
        if lens is not None:
            unseen |= lens.missing(flow)
        if deviation is not None:
            deviation[unseen] = np.inf
        trust = confidence(
            estimate.precision, unseen, normalized=estimate.normalized, freedom=estimate.freedom
        )
    history, countable = _countable(history_of(estimate.history))
    status = estimate.status
    posed = known is not None and known.translation is not None
    if status != "pose_mismatch":  # which is why, if the flow has run away as well
        vouched = estimate.matched or posed
        runaway = diverged(flow, leaves, vouched=vouched)
        if runaway is not None and not vouched and confirms_large_motion(pyramid, flow, unseen):
            runaway = diverged(flow, leaves, vouched=True)
        status = taken.overflow or runaway or (status if countable else UNCOUNTED)
    if status in ("converged", "iteration_limit", "uncertain"):
        if settings.motion == "field":
            status = field_status(pyramid, flow, trust) or status
        elif estimate.free_flow is not None:
            doubt = depth_status(pyramid, estimate, unseen)
            if doubt is not None and doubt != status:  # what was first uncertain has more to say
                status = doubt
    status = with_brightness_advice(status, pyramid, settings)
    if window is not None:
        _keep(window, pyramid, flow, unseen, status)
        if window.previous is None and before is not None and before.used:
            return interpret_pair(  # by itself
                frame0,
                frame1,
                camera=camera,
                settings=settings,
                ignored=ignored,
                stretch=stretch,
                window=window,
            )
    return Interpretation(
        rho=estimate.rho,
        flow=cv2.merge(list(flow)),  # several times as fast as a copy of the axes moved
        inverse_depth=estimate.inverse_depth,
        inverse_depth_std=deviation,
        confidence=trust,
        occlusion=unseen,
        motions=estimate.motions,
        labels=estimate.labels,
        frame=taken.frame,
        camera=taken.camera,
        settings=settings,
        status=status,
        history=history,
        version=__version__,
    )


def keep_pair(
    window: Window,
    result: Interpretation,
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None,
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None = None,
    stretch: bool = True,
) -> None:
    """Keep of a pair what the next one takes from it, as `interpret_pair` does that made `result`.

    The other arguments are those that it had.
    """
    taken = _taken(
        frame0,
        frame1,
        camera=camera,
        settings=result.settings,
        ignored=ignored,
        stretch=stretch,
    )
    flow = np.stack(cv2.split(result.flow))
    _keep(window, taken.pyramid, flow, result.occlusion, result.status)


def _keep(
    window: Window, pyramid: "ImagePyramid", flow: np.ndarray, unseen: np.ndarray, status: Status
) -> None:
    """Keep a flow, (2, H, W), for the next pair, if its status is one to rely on.

    It is round_as_packed as in a compact file, from which a run that is resumed goes on.
    """
    from tisfm.motion.previous_frame import PreviousPair

    is_reliable = status in RELIABLE
    window.previous = (
        PreviousPair.of(pyramid, round_as_packed(flow, STEP), unseen) if is_reliable else None
    )


@dataclass(frozen=True, kw_only=True)
class _Taken:
    """A pair as it is interpreted: without distortion, on the 8-bit scale.

    `camera` is a pinhole. `greys`, both frames, are there for motion ``"objects"`` alone: the
    pyramid has its own.
    """

    pyramid: "ImagePyramid"
    camera: Camera
    lens: Undistortion | None
    frame: np.ndarray
    overflow: Status | None
    greys: tuple[np.ndarray, ...]


def _taken(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None,
    settings: Settings,
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None,
    stretch: bool,
    known: KnownPose | None = None,
) -> _Taken:
    grey0, grey1 = grey_pair(frame0, frame1, stretch=stretch)
    frame = eight_bit(frame0, frame1, stretch=stretch)
    counted = _counted(ignored, grey0.shape)
    if counted is not None:
        grey0, grey1 = filled(grey0, ~counted[0]), filled(grey1, ~counted[1])
    if camera is None and settings.motion != "field":
        camera = guess_camera(grey0.shape)
    camera = check_camera(camera)

    runtime.start()  # before Taichi is imported, which looks for a cache folder as well
    from tisfm.motion.problems import pyramid_of
    from tisfm.motion.rolling_shutter import global_shutter_pair

    runtime.lane_grid(*grey0.shape)  # refuses frames that are too large
    lens = None if camera.is_pinhole else Undistortion(camera, *grey0.shape)
    if lens is not None:
        grey0, grey1, frame = map(lens.apply, (grey0, grey1, frame))
        if counted is not None:
            first, second = (lens.nearest((~c).astype(np.float32)) > 0 for c in counted)
            counted = ~first, ~second
        camera = camera.pinhole()
    overflow = overflown(grey0, grey1)
    if settings.motion == "camera" and camera.readout and overflow is None:
        seen = counted
        if lens is not None:
            both = (np.ones_like(lens.valid),) * 2 if counted is None else counted
            seen = both[0] & lens.valid, both[1] & lens.valid
        unrolled = global_shutter_pair(grey0, grey1, frame, seen, camera, settings, known)
        if unrolled is not None:
            grey0, grey1, frame = unrolled.grey0, unrolled.grey1, unrolled.frame
            counted, lens = unrolled.counted, None
            camera = replace(camera, readout=0.0)
    return _Taken(
        pyramid=pyramid_of(grey0, grey1, camera, settings, counted),
        camera=camera,
        lens=lens,
        frame=frame,
        overflow=overflow,
        greys=(grey0, grey1) if settings.motion == "objects" else (),
    )


def _ignored(mask: npt.ArrayLike, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels of both frames that a mask leaves out, (H, W) bool."""
    if isinstance(mask, (str, os.PathLike)):
        raise InputTypeError(
            f"mask is the path {os.fspath(mask)!r}: expected an array; read the file, for "
            "instance by tisfm.formats.read_image"
        )
    counted = unmasked_mask(mask, "mask")
    both = np.stack([counted, counted]) if counted.ndim == 2 else counted
    if both.shape != (2, *shape):
        height, width = shape
        raise InputError(
            f"mask is {counted.shape}: expected ({height}, {width}), the size of the frames, or "
            f"(2, {height}, {width}) with one for each of them"
        )
    return ~both[0], ~both[1]


def _counted(
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pixels of both frames that count, (H, W) bool; None where all do."""
    if ignored is None or not any(part is not None and part.any() for part in ignored):
        return None
    counted0, counted1 = (np.ones(shape, bool) if part is None else ~part for part in ignored)
    for name, counted in (("frame0", counted0), ("frame1", counted1)):
        if not counted.any():
            raise InputError(
                f"mask is black at all pixels of {name}, so nothing is left of it: black is what "
                "is ignored, white what counts"
            )
    return counted0, counted1


def _countable(history: History) -> tuple[History, bool]:
    """Return a history without iterations whose record is no number, and whether there were none.

    Their energy is beyond single precision.
    """
    finite = np.logical_and.reduce([np.isfinite(record) for record in vars(history).values()])
    if finite.all():
        return history, True
    return History(**{name: record[finite] for name, record in vars(history).items()}), False


def overflown(grey0: np.ndarray, grey1: np.ndarray) -> Status | None:
    """Return the status of frames whose constraints cannot be computed, None for others."""
    largest = max(
        abs(float(value)) for grey in (grey0, grey1) for value in (grey.min(), grey.max())
    )
    if largest <= LARGEST_SQUARED:
        return None
    return Status(
        "diverged",
        f"grey levels of up to {largest:.0e} are beyond what single precision can square: bring "
        "the frames to the 8-bit scale",
    )


def diverged(flow: np.ndarray, leaves: np.ndarray, *, vouched: bool = False) -> Status | None:
    """Return the status of a flow that no pair of frames can have, None for others.

    Parameters
    ----------
    flow : (2, H, W) float32
        (u, v), px/frame.
    leaves : (H, W) bool
        Where it leaves the image.
    vouched : bool
        Whether matched points, a pose or the images confirm a large motion
        (`tisfm.motion.frame_agreement.confirms_large_motion`): pixels that leave the image may
        then go far.
    """
    furthest, most = RUNAWAY, MOST_LEAVING
    if vouched:
        furthest, most = RUNAWAY_VOUCHED, MOST_LEAVING_VOUCHED
        flow = np.where(leaves & np.isfinite(flow), 0, flow)
    # What moves by half the image is hardly seen twice; NaN fails the comparisons as well.
    limit = furthest * max(flow.shape[1:])
    within = max(flow.max(), -flow.min()) <= limit / np.sqrt(2)
    if not within and not np.sqrt(np.einsum("khw,khw->hw", flow, flow).max()) <= limit:
        return Status(
            "diverged",
            f"image motion grew beyond {100 * furthest:g}% of the image's longer side: bring the "
            "frames to the 8-bit scale, give data_contrast a value, raise smoothness or contrast, "
            "take frames closer in time, and check the camera's focal length and centre",
        )
    leaving = float(leaves.mean())
    if leaving > most:
        return Status(
            "diverged",
            f"{100 * leaving:.0f}% of the pixels leave the image, so little is left to compare: "
            "take frames closer in time, check that they are of one scene, or raise smoothness",
        )
    return None
