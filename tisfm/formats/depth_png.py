"""Depth in 16-bit grey PNG files that state their own scale."""

import io
import math
import os

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.formats.atomic import atomic_write
from tisfm.formats.image_headers import find_missing_part
from tisfm.formats.png import encode_png
from tisfm.formats.reading import FormatError, read_bytes

_SCALE_KEYWORD = "tisfm:depth_scale"  # of the text chunk that states the scale
_MEDIAN_VALUE = 2000.0  # file value of the median depth; `choose_depth_scale` says why


def choose_depth_scale(depth: ArrayLike) -> float:
    """Choose a scale that stores the median of the valid depths as 2000.

    Relative depth has no unit, so the scale has to come from the depth itself. With the median
    stored as 2000, one step of the file is 0.05 % of the median, and depths from 1/2000 of the
    median to 32 times the median fit. Use one scale for all files of a sequence: the scale of its
    first pair with a valid depth. A file without valid depth has only zeros at any scale.

    Parameters
    ----------
    depth : array_like
        Depths in any unit; values that are not finite and positive are ignored.

    Returns
    -------
    float
        Scale for `write_depth_png`, file values per unit of depth.

    Raises
    ------
    ValueError
        If a value is masked, or no depth is valid. (A default such as 1.0 could become the scale
        of a whole sequence by mistake.)

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import choose_depth_scale
    >>> depth = np.array([[1.0, 6.5]])
    >>> bool(0 < choose_depth_scale(depth) * 6.5 <= 65535)
    True
    """
    values = check_unmasked(depth, "depth", np.float64)
    valid_depths = values[_is_valid(values)]
    if valid_depths.size == 0:
        raise InputError(
            f"depth has no finite positive value among {values.size}: no scale can be "
            "chosen; take the scale of another pair of the sequence"
        )
    return _MEDIAN_VALUE / float(np.median(valid_depths))


def write_depth_png(path: str | os.PathLike[str], depth: ArrayLike, *, scale: float) -> None:
    """Write depth as a 16-bit grey PNG; after an error there is no incomplete file.

    The value of a pixel is depth times scale, rounded and clipped to 1 to 65535; 0 stands for
    missing depth. The scale is written into the file as the text chunk "tisfm:depth_scale".

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    depth : (H, W) array_like of real numbers
        Depths in any unit. NaN, infinity, zero and negative values count as missing.
    scale : float
        File values per unit of depth, such as 5000 per metre (TUM) or 256 per metre (KITTI).

    Raises
    ------
    ValueError
        If `depth` is not (H, W), has a masked value, or `scale` is not a finite positive number.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import choose_depth_scale, read_depth_png, write_depth_png
    >>> depth = np.linspace(1, 9, 12).reshape(3, 4)
    >>> write_depth_png("depth.png", depth, scale=choose_depth_scale(depth))
    >>> bool(np.allclose(read_depth_png("depth.png"), depth, rtol=1e-3))
    True
    """
    values = check_unmasked(depth, "depth", np.float64)
    if values.ndim != 2 or values.size == 0:
        raise InputError(f"depth is {values.shape}, expected (H, W) with some pixels")
    _check_scale(scale)
    with np.errstate(over="ignore", invalid="ignore"):  # infinity is clipped, NaN is not valid
        scaled_depth = values * scale
        np.rint(scaled_depth, out=scaled_depth)
        np.clip(scaled_depth, 1, 65535, out=scaled_depth)
    np.copyto(scaled_depth, 0, where=~_is_valid(values))
    pixels = scaled_depth.astype(np.uint16)
    with atomic_write(path) as file:
        file.writelines(encode_png(pixels, {_SCALE_KEYWORD: repr(float(scale))}))


def read_depth_png(
    path: str | os.PathLike[str], *, scale: float | None = None
) -> NDArray[np.float32]:
    """Read depth from a 16-bit grey PNG.

    Parameters
    ----------
    path : str or os.PathLike
        File to read.
    scale : float, optional
        File values per unit of depth, instead of the scale that the file states.

    Returns
    -------
    (H, W) float32 ndarray
        Depth, value divided by scale; NaN where the file has 0.

    Raises
    ------
    FormatError
        If the file is damaged, not a 16-bit grey PNG, or states no scale and none is given.
    ValueError
        If `scale` is not a finite positive number.
    OSError
        If the file does not exist or cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_depth_png, write_depth_png
    >>> write_depth_png("depth.png", np.array([[2.0, np.nan]]), scale=5000)  # as TUM has it
    >>> read_depth_png("depth.png").tolist()  # the file says its scale
    [[2.0, nan]]
    """
    name = os.fspath(path)
    if scale is not None:
        _check_scale(scale)
    data = read_bytes(name)
    missing_part = find_missing_part(data)
    if missing_part is not None:
        raise FormatError(f"{name} is cut off after {len(data)} bytes: {missing_part} is missing")
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
            picture.load()
            # Older versions of Pillow widen 16-bit grey ("I;16") to 32 bits ("I").
            mode = picture.mode
            pixels = np.asarray(picture)
            scale_text = picture.info.get(_SCALE_KEYWORD)
    except MemoryError:
        raise
    except Exception as error:  # damaged files make Pillow's decoder raise many kinds of errors
        raise FormatError(f"{name} cannot be read as a depth PNG: {error}") from error
    if mode not in ("I;16", "I;16B", "I"):
        raise FormatError(f"{name} is a PNG of mode {mode}, expected 16-bit grey: not a depth file")
    if scale is None:
        scale = _parse_scale(name, scale_text)
    depth = pixels.astype(np.float64) / scale
    depth[pixels == 0] = np.nan
    return depth.astype(np.float32)


def _parse_scale(name: str, scale_text: object) -> float:
    """Return the scale from the text chunk of a file."""
    if scale_text is None:
        raise FormatError(
            f"{name} does not state its scale (no text chunk {_SCALE_KEYWORD!r}): give scale, "
            "for example 5000 per metre for TUM or 256 per metre for KITTI"
        )
    try:
        scale = float(str(scale_text))
        _check_scale(scale)
    except ValueError as error:
        raise FormatError(
            f"{name} states the scale {scale_text!r}, expected a finite positive number: give scale"
        ) from error
    return scale


def _is_valid(depth: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark the depths that are finite and positive."""
    return np.isfinite(depth) & (depth > 0)


def _check_scale(scale: float) -> None:
    """Raise ValueError unless a scale is finite and positive."""
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"scale is {scale!r}, expected a finite positive number")
