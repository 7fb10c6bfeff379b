"""Frames in: validation, and conversion to grey levels on the 8-bit scale."""

import numpy as np
import numpy.typing as npt

MIN_SIDE = 4  # px: below it a five-tap derivative sees nothing but border

# ITU-R BT.601 luma.
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def grey_pair(frame0: npt.ArrayLike, frame1: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Validate a pair of frames and convert it to grey levels.

    Parameters
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) array
        Grey or RGB; uint8, uint16 or float, both alike.

    Returns
    -------
    grey0, grey1 : (H, W) float32
        On the 8-bit scale, by one factor for both frames: uint8 as it is, uint16 / 257,
        float × 255 if both frames lie in [0, 1], else as it is. Never views of the input.

    Raises
    ------
    TypeError
        If a frame is not an array of one of these types, or the two differ in type.
    ValueError
        If shapes differ, a side is shorter than 4 px, or a pixel is NaN or infinite.
    """
    first, second = check_frame(frame0, "frame0"), check_frame(frame1, "frame1")
    if first.shape != second.shape:
        raise ValueError(
            f"frame1 is {second.shape} but frame0 is {first.shape}: "
            "frames of a pair must have the same size and channels"
        )
    if first.dtype != second.dtype and not (_is_float(first) and _is_float(second)):
        raise TypeError(
            f"frame1 is {second.dtype} but frame0 is {first.dtype}: "
            "frames of a pair must have the same type"
        )
    factor = _factor(first, second)
    return _grey(first, factor), _grey(second, factor)


def check_frame(frame: npt.ArrayLike, name: str) -> np.ndarray:
    """Return the frame as an array, or raise as `grey_pair` does."""
    array = np.asarray(frame)
    if array.dtype not in (np.uint8, np.uint16) and not _is_float(array):
        raise TypeError(f"{name} is of type {array.dtype}: expected uint8, uint16 or float")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.ndim != 2 and not (array.ndim == 3 and array.shape[2] == 3):
        raise ValueError(f"{name} is {array.shape}: expected (H, W) grey or (H, W, 3) RGB")
    height, width = array.shape[:2]
    if min(height, width) < MIN_SIDE:
        raise ValueError(
            f"{name} is {height} × {width} px: expected at least {MIN_SIDE} × {MIN_SIDE}"
        )
    if _is_float(array) and not np.isfinite(array).all():
        bad = int(array.size - np.isfinite(array).sum())
        raise ValueError(
            f"{name} has {bad} values that are NaN or infinite: replace them, for instance by "
            "np.nan_to_num, before interpreting"
        )
    return array


def eight_bit(frame: npt.ArrayLike) -> np.ndarray:
    """Return a frame as uint8 of the same shape, for display, scaled as `grey_pair` does."""
    array = check_frame(frame, "frame")
    if array.dtype == np.uint8:
        return array.copy()
    scaled = array.astype(np.float32) * np.float32(_factor(array, array))
    return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)


def _is_float(array: np.ndarray) -> bool:
    return bool(np.issubdtype(array.dtype, np.floating))


def _factor(first: np.ndarray, second: np.ndarray) -> float:
    if first.dtype == np.uint16:
        return 1 / 257
    if _is_float(first):
        low = min(first.min(), second.min())
        high = max(first.max(), second.max())
        if low >= 0 and high <= 1:
            return 255.0
    return 1.0


def _grey(frame: np.ndarray, factor: float) -> np.ndarray:
    grey = frame.astype(np.float32)
    if grey.ndim == 3:
        grey = grey @ _LUMA
    grey *= np.float32(factor)
    if not np.isfinite(grey).all():
        raise ValueError("a frame has values too large for float32: scale it before interpreting")
    return np.ascontiguousarray(grey)
