"""Checks of both video readers: missing frames, too large frames, pixels that are not square."""

import cv2
import numpy as np

from tisfm.errors import InputError
from tisfm.formats import FormatError


def lacks_frames(count: int, announced: int | None) -> bool:
    """Return whether a video has fewer frames than it states.

    Files state up to two frames, or 2 %, too many without being cut off.
    """
    return announced is not None and count < announced - max(2, announced // 50)


def ends_early(
    count: int,  # number of frames
    # last, end: time of the last frame, and the stated end, s, if known
    last: float | None,
    end: float | None,
) -> bool | None:
    """Return whether the last frame is long before the stated end of a video; None if unknown."""
    if last is None or end is None:
        return None
    # Tolerance, set by hand: 2 % of the length and three frames.
    return last < 0.98 * end - 3 * last / max(count - 1, 1)


def cut_off_error(path: str, after: str, total: str) -> ValueError:
    """Return the error for a video that ends before its stated end."""
    return InputError(
        f"{path} ends after {after} of {total}: the file is cut off or damaged; the results up to "
        "there are complete"
    )


MAX_FRAME_PIXELS = 2**26
"""Pixels of a frame beyond which no video is decoded, 8192 × 8192: a damaged file of kilobytes may
state any size, and decoders hold up to 17 frames at once."""


def refuse_large_frames(path: str, width: int, height: int) -> None:
    """Raise FormatError for frames of more than `MAX_FRAME_PIXELS` pixels."""
    if width * height > MAX_FRAME_PIXELS:
        raise FormatError(
            f"{path} has frames of {width} × {height} px, more than {MAX_FRAME_PIXELS} pixels: "
            "it is damaged, or has to be shrunk"
        )


_MAX_ASPECT = 8.0  # files that state more, or less than the inverse, are damaged


def square_size(
    # width, height: of the frame, px
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
