"""Optical flow in KITTI's 16-bit PNG files."""

import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.formats.float_maps import check_real_numbers
from tisfm.formats.images import read_image, write_png
from tisfm.formats.reading import FormatError

_ZERO_VALUE = 2**15  # file value of no motion
_VALUES_PER_PX = 64  # file values per pixel of motion
_MIN_FLOW = -_ZERO_VALUE / _VALUES_PER_PX  # px
_MAX_FLOW = (2**16 - 1 - _ZERO_VALUE) / _VALUES_PER_PX  # px


def read_kitti_flow(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read a flow field from a KITTI flow PNG.

    Parameters
    ----------
    path : str or os.PathLike
        File to read: 16-bit, three channels (u, v, valid), a motion of m px stored as
        64 m + 2¹⁵.

    Returns
    -------
    (H, W, 2) float32 ndarray
        Flow (u, v), px; NaN where the file marks it as not valid.

    Raises
    ------
    FormatError
        If the file is damaged or incomplete, or not a picture of three 16-bit channels.
    OSError
        If the file does not exist or cannot be read.

    References
    ----------
    M. Menze and A. Geiger, "Object scene flow for autonomous vehicles", CVPR 2015, 3061-3070,
    doi:10.1109/CVPR.2015.7298925.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_kitti_flow, write_kitti_flow
    >>> write_kitti_flow("flow.png", np.full((48, 64, 2), np.nan))  # unknown
    >>> bool(np.isnan(read_kitti_flow("flow.png")).all())
    True
    """
    pixels = read_image(path)
    if pixels.dtype != np.uint16 or pixels.ndim != 3:
        channels = 1 if pixels.ndim == 2 else pixels.shape[2]
        raise FormatError(
            f"{os.fspath(path)} is a picture of {channels} x {pixels.dtype}, expected 3 x uint16: "
            "not a KITTI flow file"
        )
    flow = (pixels[..., :2].astype(np.float32) - np.float32(_ZERO_VALUE)) / np.float32(
        _VALUES_PER_PX
    )
    flow[pixels[..., 2] == 0] = np.nan
    return flow


def write_kitti_flow(path: str | os.PathLike[str], flow: ArrayLike) -> None:
    """Write a flow field to a KITTI flow PNG; after an error there is no incomplete file.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    flow : (H, W, 2) array_like of real numbers
        Flow (u, v), px, rounded to 1/64 px. A pixel with NaN in either component is written as not
        valid.

    Raises
    ------
    ValueError
        If `flow` is not (H, W, 2), a value is masked, or a known flow is outside -512 to
        511.984375 px, which the format cannot hold.
    TypeError
        If `flow` does not hold real numbers.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.formats import read_kitti_flow, write_kitti_flow
    >>> write_kitti_flow("flow.png", np.full((48, 64, 2), 1.25))
    >>> read_kitti_flow("flow.png")[0, 0].tolist()  # in steps of 1/64 px
    [1.25, 1.25]
    """
    values = check_real_numbers("flow", flow).astype(np.float64)
    if values.ndim != 3 or values.shape[2] != 2 or values.size == 0:
        raise InputError(f"flow is {values.shape}, expected (H, W, 2) with some pixels")
    is_valid = ~np.isnan(values).any(axis=2)
    valid_flow = values[is_valid]
    levels = np.rint(valid_flow * _VALUES_PER_PX) + _ZERO_VALUE
    is_outside = (levels < 0) | (levels >= 2**16)
    if is_outside.any():
        raise InputError(
            f"flow is outside {_MIN_FLOW:g} to {_MAX_FLOW} px, the range of a KITTI flow PNG, at "
            f"{np.count_nonzero(is_outside.any(axis=1))} pixels, for instance "
            f"{valid_flow[is_outside][0]:g}: set unknown flow to NaN, or write a .flo file"
        )
    pixels = np.zeros((*is_valid.shape, 3), np.uint16)
    pixels[is_valid, :2] = levels
    pixels[is_valid, 2] = 1
    write_png(path, pixels)
