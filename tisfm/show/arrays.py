"""Checks and conversions of the arrays of pictures."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.frames import in_unit_range


def as_map(name: str, values: ArrayLike) -> NDArray[np.floating[Any]]:
    """Return an (H, W) map of real numbers as floats. Errors contain `name`."""
    array = _as_real(name, values)
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"{name} is {array.shape}, expected (H, W) with some pixels")
    return _as_float(array)


def as_flow(name: str, values: ArrayLike) -> NDArray[np.floating[Any]]:
    """Return an (H, W, 2) flow as floats. Errors contain `name`."""
    array = _as_real(name, values)
    if array.ndim != 3 or array.shape[2] != 2 or array.size == 0:
        raise InputError(f"{name} is {array.shape}, expected (H, W, 2) with some pixels")
    return _as_float(array)


def as_image(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return an (H, W) or (H, W, 3) picture unchanged. Errors contain `name`."""
    array = _as_real(name, values)
    if array.size == 0 or not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)):
        raise InputError(f"{name} is {array.shape}, expected (H, W) or (H, W, 3) with some pixels")
    return array


def valid_depth_mask(values: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return the mask of valid depths or inverse depths: finite and positive."""
    return np.asarray(np.isfinite(values) & (values > 0))


def require_same_size(
    name: str, array: NDArray[Any], other_name: str, other_array: NDArray[Any]
) -> None:
    """Raise an error that gives both sizes unless two arrays have the same rows and columns."""
    if array.shape[:2] != other_array.shape[:2]:
        raise InputError(
            f"{name} is {array.shape[:2]} but {other_name} is {other_array.shape[:2]}: "
            "they must have the same size"
        )


def check_limit(name: str, limit: float) -> float:
    """Return the upper end of a range as a float; raise an error unless it is finite and >= 0."""
    if not (np.isfinite(limit) and limit >= 0):
        raise InputError(f"{name} is {limit!r}, expected a finite number, zero or greater")
    return float(limit)


def as_uint8(
    # ndarray: uint8 stays; uint16 is divided by 257; floats are multiplied by 255 if all are in [0,
    # 1], apart from slight overshoots (`tisfm.frames.in_unit_range`). Other floats and integers
    # keep their values. NaN becomes black.
    *images: NDArray[Any],
) -> tuple[NDArray[np.uint8], ...]:  # tuple of uint8 ndarray: the pictures, rounded and clipped
    """Convert pictures to 8 bits, all by one factor."""
    floats = [image for image in images if image.dtype.kind == "f"]
    is_unit_range = all(in_unit_range(np.nan_to_num(image, nan=0.0)) for image in floats)
    factors = {"uint16": 1 / 257, "float": 255.0 if is_unit_range else 1.0}
    pictures = []
    for image in images:
        if image.dtype != np.uint8:
            dtype_name = "float" if image.dtype.kind == "f" else image.dtype.name
            factor = factors.get(dtype_name, 1.0)
            levels = np.nan_to_num(image.astype(np.float32) * np.float32(factor), nan=0.0)
            image = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        pictures.append(image)
    return tuple(pictures)


def as_rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture with three channels."""
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


def _as_real(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return an array of real numbers. Errors contain `name`."""
    array = check_unmasked(values, name)
    if array.dtype.kind not in "iuf":
        raise InputTypeError(f"{name} has dtype {array.dtype}, expected real numbers")
    return array


def _as_float(array: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """Keep float64; convert other types to float32, which suffices for a picture."""
    return array if array.dtype == np.float64 else array.astype(np.float32, copy=False)
