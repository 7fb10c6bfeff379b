"""Checks of input frames, and their conversion to grey levels on the 8-bit scale."""

import os

import numpy as np
import numpy.typing as npt

from tisfm.checks import refuse_masked
from tisfm.errors import InputError, InputTypeError

MIN_SIDE = 4  # px: on a shorter side a five-tap derivative depends mainly on the border
MAX_GREY = 1e36  # grey levels: differences of such values still fit into float32
# Float frames in [0, 1] may overshoot. Each pair is a distance beyond [0, 1], and the largest share
# of values that may lie farther out. 0.01 allows for rounding: after resampling and sharpening, up
# to a sixth of the values lie farther out. 1 allows for strong sharpening, 10 for bright spots. A
# frame on the 8-bit scale within these limits is black apart from spots: 99% of its values are at
# most grey level 2.
MAX_OVERSHOOTS = ((0.01, 0.2), (1.0, 0.01), (10.0, 0.001))
ROWS_PER_STEP = 32  # rows converted at a time, few enough to stay in the cache

# ITU-R BT.601 luma.
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def grey_pair(
    # frame0, frame1: (H, W) or (H, W, 3) array: grey or RGB; uint8, uint16 or float, the same type
    # for both
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    # Whether float frames in [0, 1] are multiplied by 255. False if other frames of the sequence
    # show that the frames are already on the 8-bit scale.
    scales_unit_range: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Validate a pair of frames and convert it to grey levels.

    Returns both frames, (H, W) float32, on the 8-bit scale with one factor for both: uint8
    unchanged, uint16 / 257, float × 255 if both frames are in [0, 1] (`in_unit_range`), other float
    unchanged. The arrays are copies.

    Raises TypeError if a frame is not an array of one of these types, or the two differ in type.

    Raises ValueError if shapes differ, a side is shorter than 4 px, or a pixel is masked, NaN,
    infinite or beyond 1e36.
    """
    image0, image1 = check_frame(frame0, "frame0"), check_frame(frame1, "frame1")
    if image0.shape != image1.shape:
        raise InputError(
            f"frame1 is {image1.shape} but frame0 is {image0.shape}: "
            "frames of a pair must have the same size and channels"
        )
    if image0.dtype != image1.dtype and not (_is_float(image0) and _is_float(image1)):
        raise InputTypeError(
            f"frame1 is {image1.dtype} but frame0 is {image0.dtype}: "
            "frames of a pair must have the same type"
        )
    factor = _grey_factor(image0, image1, scales_unit_range=scales_unit_range)
    return _to_grey(image0, factor), _to_grey(image1, factor)


def check_frame(frame: npt.ArrayLike, name: str) -> np.ndarray:
    """Return the frame as an array in native byte order; raise as `grey_pair` does."""
    if isinstance(frame, (str, os.PathLike)):
        raise InputTypeError(
            f"{name} is the path {os.fspath(frame)!r}: expected an array; read the file, for "
            "instance by tisfm.formats.read_image"
        )
    refuse_masked(
        frame,
        name,
        f"every pixel of a frame is used: fill them, for instance by {name}.filled(0), and do not "
        "use the result at these pixels",
    )
    try:
        array = np.asarray(frame)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{name} is not an array: {error}") from None
    array = array.astype(array.dtype.newbyteorder("="), copy=False)
    if array.dtype not in (np.uint8, np.uint16) and not _is_float(array):
        raise InputTypeError(
            f"{name} is of type {array.dtype}: expected uint8, uint16 or float; convert it, for "
            "instance by .astype(np.uint8) if it has 8-bit grey levels"
        )
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.ndim != 2 and not (array.ndim == 3 and array.shape[2] == 3):
        raise InputError(f"{name} is {array.shape}: expected (H, W) grey or (H, W, 3) RGB")
    height, width = array.shape[:2]
    if min(height, width) < MIN_SIDE:
        raise InputError(
            f"{name} is {height} × {width} px: expected at least {MIN_SIDE} × {MIN_SIDE}"
        )
    if _is_float(array) and not np.isfinite(array).all():
        invalid_count = int(array.size - np.isfinite(array).sum())
        raise InputError(
            f"{name} is NaN or infinite at {invalid_count} of {array.size} values: replace them, "
            "for instance by np.nan_to_num, before interpreting"
        )
    return array


def to_eight_bit(
    frame0: npt.ArrayLike, frame1: npt.ArrayLike, *, scales_unit_range: bool = True
) -> np.ndarray:
    """Return frame 0 of a pair as uint8 for display, scaled by the factor of `grey_pair`."""
    image0, image1 = check_frame(frame0, "frame0"), check_frame(frame1, "frame1")
    if image0.dtype == np.uint8:
        return image0.copy()
    scaled_frame = image0.astype(np.float32, order="C") * np.float32(
        _grey_factor(image0, image1, scales_unit_range=scales_unit_range)
    )
    return np.clip(np.rint(scaled_frame), 0, 255).astype(np.uint8)


def in_unit_range(frame: np.ndarray) -> bool:
    """Return whether the values of a float frame are in [0, 1], apart from overshoots.

    They are if 80% lie in [−0.01, 1.01], 99% in [−1, 2], and 99.9% in [−10, 11]. Interpolation of
    a frame in [0, 1] moves some values out of the range, sharpening moves more, and some pixels may
    be wrong; so no single value decides. The answer is also True for a very dark frame on the
    8-bit scale: black, with bright spots on less than a thousandth of the pixels. It is True for
    integer types, whose scale is given by the type.
    """
    if not _is_float(frame) or frame.size == 0:
        return True
    if frame.min() >= 0 and frame.max() <= 1:  # true for most frames, in a tenth of the time
        return True
    return all(
        np.count_nonzero((frame < -overshoot) | (frame > 1 + overshoot)) <= max_share * frame.size
        for overshoot, max_share in MAX_OVERSHOOTS
    )


def _is_float(array: np.ndarray) -> bool:
    return bool(np.issubdtype(array.dtype, np.floating))


def _grey_factor(image0: np.ndarray, image1: np.ndarray, *, scales_unit_range: bool) -> float:
    if image0.dtype == np.uint16:
        return 1 / 257
    if scales_unit_range and _is_float(image0) and in_unit_range(image0) and in_unit_range(image1):
        return 255.0
    return 1.0


def _to_grey(frame: np.ndarray, factor: float) -> np.ndarray:
    with np.errstate(over="ignore"):
        grey = _luma(frame) if frame.ndim == 3 else frame.astype(np.float32, order="C")
        if factor != 1:
            grey *= np.float32(factor)
    # Differences of grey levels must be finite too.
    if _is_float(frame) and not np.abs(grey).max() <= MAX_GREY:
        raise InputError("a frame has values too large for float32: scale it before interpreting")
    return grey


def _luma(frame: np.ndarray) -> np.ndarray:
    """Return the luma of an RGB frame, (H, W) float32."""
    grey = np.empty(frame.shape[:2], np.float32)
    for top in range(0, len(frame), ROWS_PER_STEP):
        rows, luma = frame[top : top + ROWS_PER_STEP], grey[top : top + ROWS_PER_STEP]
        # Channel by channel: a matrix product may round differently on another machine.
        red, green, blue = (rows[..., k].astype(np.float32) for k in range(3))
        np.multiply(red, _LUMA[0], out=luma)
        green *= _LUMA[1]
        luma += green
        blue *= _LUMA[2]
        luma += blue
    return grey
