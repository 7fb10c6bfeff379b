"""Disparities of stereo pairs."""

import io
import os

import numpy as np
from numpy.typing import NDArray

from tisfm.formats import FormatError, read_image
from tisfm.formats.reading import read_bytes

_KITTI_STEPS = 256  # 16-bit file values per pixel of disparity


def read_disparity(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read the disparity of a left view.

    Parameters
    ----------
    path : str or os.PathLike
        A picture: uint8 in px, uint16 in px / 256 as in KITTI, both 0 where unknown, or float in
        px. Or one array in an .npy or .npz file, by the same rules.

    Returns
    -------
    (H, W) float32 ndarray
        Disparity, x_left - x_right, px; NaN where unknown (0 of integers, floats not finite).

    Raises
    ------
    FormatError
        If the file is damaged, or does not hold one (H, W) map of these types.
    OSError
        If the file does not exist or cannot be read.
    """
    name = os.fspath(path)
    stored = _read_array(name) if name.lower().endswith((".npy", ".npz")) else read_image(name)
    if stored.ndim != 2 or stored.size == 0:
        raise FormatError(f"{name} holds {stored.shape}, expected a disparity map, (H, W)")
    if stored.dtype.kind == "f":
        return np.where(np.isfinite(stored), stored, np.nan).astype(np.float32)
    if stored.dtype not in (np.uint8, np.uint16):
        raise FormatError(f"{name} holds {stored.dtype}, expected uint8, uint16 or float")
    disparity = stored.astype(np.float32)
    if stored.dtype == np.uint16:
        disparity /= np.float32(_KITTI_STEPS)
    disparity[stored == 0] = np.nan
    return disparity


def _read_array(name: str) -> NDArray[np.generic]:
    """Return the one array of an .npy or .npz file."""
    data = read_bytes(name)
    try:
        loaded = np.load(io.BytesIO(data), allow_pickle=False)
        arrays = (
            [loaded] if isinstance(loaded, np.ndarray) else [loaded[key] for key in loaded.files]
        )
    except Exception as error:  # the decoders raise whatever a damaged file leads them to
        reason = " ".join(str(error).split())
        raise FormatError(f"{name} cannot be read as NumPy arrays: {reason}") from error
    if len(arrays) != 1:
        raise FormatError(f"{name} holds {len(arrays)} arrays, expected one: the disparity")
    return arrays[0]
