"""A pair of frames prepared for interpretation: grey levels, masks, lens and rolling shutter."""

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tisfm import runtime
from tisfm.camera import Camera, check_camera
from tisfm.checks import check_mask
from tisfm.errors import InputError, InputTypeError
from tisfm.focal_guess import guess_camera
from tisfm.frames import grey_pair, to_eight_bit
from tisfm.lens import Undistortion
from tisfm.rigid import KnownPose
from tisfm.settings import Settings
from tisfm.solver.pixel_masks import fill_ignored
from tisfm.status import Status

if TYPE_CHECKING:
    from tisfm.solver.image_pyramid import ImagePyramid

MAX_SQUARABLE_GREY = 1e15  # grey levels: squares of derivatives must fit into float32


@dataclass(frozen=True, kw_only=True)
class PreparedPair:
    """Two frames on the 8-bit scale, without distortion and without rolling shutter."""

    pyramid: "ImagePyramid"  # image pyramid of both frames
    camera: Camera  # a pinhole
    lens: Undistortion | None  # the distortion that was undone
    frame: np.ndarray  # (H, W) or (H, W, 3) uint8: frame 0, for display
    overflow: Status | None  # the status of frames that are too bright for float32
    # tuple of (H, W) float32: both frames for motion ``"objects"``, empty for other motions
    greys: tuple[np.ndarray, ...]


def prepare_pair(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera | None,
    settings: Settings,
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None,
    scales_unit_range: bool,  # whether float frames in [0, 1] are brought to the 8-bit scale
    known_pose: KnownPose | None = None,
) -> PreparedPair:
    """Return a pair ready for interpretation; the arguments are as for `interpret_pair`."""
    grey0, grey1 = grey_pair(frame0, frame1, scales_unit_range=scales_unit_range)
    frame = to_eight_bit(frame0, frame1, scales_unit_range=scales_unit_range)
    valid_pixels = _used_pixels(ignored, grey0.shape)
    if valid_pixels is not None:
        grey0, grey1 = fill_ignored(grey0, ~valid_pixels[0]), fill_ignored(grey1, ~valid_pixels[1])
    if camera is None and settings.motion != "field":
        camera = guess_camera(grey0.shape)
    camera = check_camera(camera)

    runtime.start()  # first: importing Taichi already looks for a cache folder
    from tisfm.motion.problems import pyramid_of
    from tisfm.motion.rolling_shutter import global_shutter_pair

    runtime.lane_grid(*grey0.shape)  # refuses frames that are too large
    lens = None if camera.is_pinhole else Undistortion(camera, *grey0.shape)
    if lens is not None:
        grey0, grey1, frame = map(lens.apply, (grey0, grey1, frame))
        if valid_pixels is not None:
            ignored0, ignored1 = (
                lens.apply_nearest((~pixels).astype(np.float32)) > 0 for pixels in valid_pixels
            )
            valid_pixels = ~ignored0, ~ignored1
        camera = camera.pinhole()
    overflow = overflow_status(grey0, grey1)
    if settings.motion == "camera" and camera.readout and overflow is None:
        has_data = valid_pixels
        if lens is not None:
            used_pixels = (np.ones_like(lens.valid),) * 2 if valid_pixels is None else valid_pixels
            has_data = used_pixels[0] & lens.valid, used_pixels[1] & lens.valid
        corrected_pair = global_shutter_pair(
            grey0, grey1, frame, has_data, camera, settings, known_pose
        )
        if corrected_pair is not None:
            grey0, grey1, frame = corrected_pair.grey0, corrected_pair.grey1, corrected_pair.frame
            valid_pixels, lens = corrected_pair.valid, None
            camera = replace(camera, readout=0.0)
    return PreparedPair(
        pyramid=pyramid_of(grey0, grey1, camera, settings, valid_pixels),
        camera=camera,
        lens=lens,
        frame=frame,
        overflow=overflow,
        greys=(grey0, grey1) if settings.motion == "objects" else (),
    )


def ignored_pixels(mask: npt.ArrayLike, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels of both frames that a mask excludes, (H, W) bool."""
    if isinstance(mask, (str, os.PathLike)):
        raise InputTypeError(
            f"mask is the path {os.fspath(mask)!r}: expected an array; read the file, for "
            "instance by tisfm.formats.read_image"
        )
    is_used = check_mask(mask, "mask")
    used_pixels = np.stack([is_used, is_used]) if is_used.ndim == 2 else is_used
    if used_pixels.shape != (2, *shape):
        height, width = shape
        raise InputError(
            f"mask is {is_used.shape}: expected ({height}, {width}), the size of the frames, or "
            f"(2, {height}, {width}) with one for each of them"
        )
    return ~used_pixels[0], ~used_pixels[1]


def _used_pixels(
    ignored: tuple[np.ndarray | None, np.ndarray | None] | None, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pixels of both frames that are used, (H, W) bool; None if all are used."""
    if ignored is None or not any(pixels is not None and pixels.any() for pixels in ignored):
        return None
    used0, used1 = (np.ones(shape, bool) if pixels is None else ~pixels for pixels in ignored)
    for name, used_in_frame in (("frame0", used0), ("frame1", used1)):
        if not used_in_frame.any():
            raise InputError(
                f"mask is black at all pixels of {name}, so no pixel is left: black pixels "
                "are ignored, white pixels are used"
            )
    return used0, used1


def overflow_status(grey0: np.ndarray, grey1: np.ndarray) -> Status | None:
    """Return the status of frames that are too bright for float32, None for others."""
    max_grey = max(
        abs(float(value)) for grey in (grey0, grey1) for value in (grey.min(), grey.max())
    )
    if max_grey <= MAX_SQUARABLE_GREY:
        return None
    return Status(
        "diverged",
        f"grey levels of up to {max_grey:.0e} are beyond what single precision can square: bring "
        "the frames to the 8-bit scale",
    )
