"""Checks of both video readers: missing frames, too large frames, pixels that are not square."""

import cv2
import numpy as np

from tisfm.errors import InputError
from tisfm.formats import FormatError


def lacks_frames(count: int, stated_count: int | None) -> bool:
    """Return whether a video has fewer frames than it states.

    A complete file may state up to two frames, or 2 % of its frames, too many.
    """
    return stated_count is not None and count < stated_count - max(2, stated_count // 50)


def ends_early(
    count: int,  # number of frames
    # time of the last frame, and the stated end of the video, s, if known
    last_time: float | None,
    stated_end: float | None,
) -> bool | None:
    """Return whether the last frame is long before the stated end of a video; None if unknown."""
    if last_time is None or stated_end is None:
        return None
    # Tolerance, set by hand: 2 % of the length and three frames.
    return last_time < 0.98 * stated_end - 3 * last_time / max(count - 1, 1)


def cut_off_error(
    path: str,
    part: str,  # number of frames or time that was read, as text such as "12"
    total: str,  # stated number or time with its unit, as text such as "30 frames"
) -> ValueError:
    """Return the error for a video that ends before its stated end."""
    return InputError(
        f"{path} ends after {part} of {total}: the file is cut off or damaged; the results up to "
        "there are complete"
    )


MAX_FRAME_PIXELS = 2**26
"""Maximum number of pixels of a video frame, 8192 × 8192. A damaged file of a few kilobytes can
state any size, and decoders store up to 17 frames at once."""


def refuse_large_frames(path: str, width: int, height: int) -> None:
    """Raise FormatError for frames of more than `MAX_FRAME_PIXELS` pixels."""
    if width * height > MAX_FRAME_PIXELS:
        raise FormatError(
            f"{path} has frames of {width} × {height} px, more than {MAX_FRAME_PIXELS} pixels: "
            "the file is damaged, or the video has to be shrunk"
        )


_MAX_ASPECT = 8.0  # longer side of a pixel over the shorter side; only damaged files state more


def square_size(
    # width and height of the frame, px
    width: int,
    height: int,
    aspect: float,  # Width of a pixel over its height. Values outside 1/8 to 8 count as 1.
) -> tuple[int, int]:
    """Return width and height of a frame with square pixels, px; no pixel is lost."""
    if not 1 / _MAX_ASPECT <= aspect <= _MAX_ASPECT:
        return width, height
    return (round(width * aspect), height) if aspect > 1 else (width, round(height / aspect))


def resample_to_square_pixels(image: np.ndarray, aspect: float) -> np.ndarray:
    """Return a frame, (H, W, 3) uint8, resampled to the size of `square_size`."""
    height, width = image.shape[:2]
    size = square_size(width, height, aspect)
    if size == (width, height):
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)


def resampling_note(path: str, width: int, height: int, aspect: float) -> str:
    """Return a note that frames of this size are resampled; "" if their pixels are square."""
    size = square_size(width, height, aspect)
    if size == (width, height):
        return ""
    return (
        f"the pixels of {path} are not square ({aspect:.4g} times as wide as high): frames are "
        f"resampled from {width} × {height} to {size[0]} × {size[1]} px, as players show them; "
        "give the camera, crop, masks and labels for the resampled frames"
    )
