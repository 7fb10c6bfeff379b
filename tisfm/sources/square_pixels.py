"""Videos whose pixels are not square: frames are enlarged along one axis until they are."""

import cv2
import numpy as np

_LARGEST_ASPECT = 8.0  # files that state more, or less than the inverse, are damaged


def square_size(width: int, height: int, aspect: float) -> tuple[int, int]:
    """Return width and height of a frame with square pixels, px; no pixel is lost.

    Parameters
    ----------
    width, height : int
        Of the frame, px.
    aspect : float
        Width of a pixel over its height. Values outside 1/8 to 8 are taken for 1.
    """
    if not 1 / _LARGEST_ASPECT <= aspect <= _LARGEST_ASPECT:
        return width, height
    return (round(width * aspect), height) if aspect > 1 else (width, round(height / aspect))


def with_square_pixels(image: np.ndarray, aspect: float) -> np.ndarray:
    """Return a frame, (H, W, 3) uint8, resampled to the size of `square_size`."""
    height, width = image.shape[:2]
    size = square_size(width, height, aspect)
    if size == (width, height):
        return image
    return cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)


def resampling_note(path: str, width: int, height: int, aspect: float) -> str:
    """Return a note on a video with frames of this size, "" if its pixels are square."""
    size = square_size(width, height, aspect)
    if size == (width, height):
        return ""
    return (
        f"the pixels of {path} are not square ({aspect:.4g} times as wide as high): frames are "
        f"resampled from {width} × {height} to {size[0]} × {size[1]} px, as players show them; "
        "give the camera, crop, masks and labels for the resampled frames"
    )
