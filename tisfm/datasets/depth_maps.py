"""Depth maps of depth cameras, as the camera beside them sees the depth."""

import os

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.formats import FormatError, read_image

_MISSING = (0, 65535)
MILLIMETRES = 1000.0  # file values per metre


def read_depth(path: str | os.PathLike[str], scale: float = MILLIMETRES) -> NDArray[np.float32]:
    """Read a depth map.

    Parameters
    ----------
    path : str or os.PathLike
        A 16-bit picture, 0 or 65535 where there is no depth.
    scale : float, default 1000
        File values per unit of depth; by default they are millimetres, and depth is in metres.

    Returns
    -------
    (H, W) float32 ndarray
        Depth Z; NaN where there is none.

    Raises
    ------
    FormatError
        If the file is damaged, or no (H, W) picture of 16 bits.
    OSError
        If the file does not exist or cannot be read.
    """
    stored = read_image(path)
    if stored.ndim != 2 or stored.dtype != np.uint16:
        raise FormatError(
            f"{os.fspath(path)} holds {stored.shape} {stored.dtype}, expected a depth map, (H, W) "
            "uint16"
        )
    depth = stored.astype(np.float32) / np.float32(scale)
    depth[np.isin(stored, _MISSING)] = np.nan
    return depth


def seen_from(
    depth: NDArray[np.float32], own: Camera, other: Camera, offset: float
) -> NDArray[np.float32]:
    """Bring a depth map to the picture of a camera beside the one that took it.

    Parameters
    ----------
    depth : (H, W) float32
        Z in the axes of the camera that took it, NaN where there is none.
    own, other : Camera
        That camera, and the one beside it, which looks the same way and has pictures of the same
        size. A longer focal length would leave gaps.
    offset : float
        Where the other is, along X, in the unit of the depth.

    Returns
    -------
    (H, W) float32 ndarray
        Depth at the pixels of the other camera: that of the nearest surface that falls on the
        pixel. NaN where none does.
    """
    height, width = depth.shape
    rows, columns = np.nonzero(np.isfinite(depth) & (depth > 0))
    z = depth[rows, columns]
    (own_x, own_y), (x0, y0) = (camera.center_for(height, width) for camera in (own, other))
    ratio = other.focal / own.focal
    x = np.rint((columns - own_x) * ratio - other.focal * offset / z + x0)
    y = np.rint((rows - own_y) * ratio + y0)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    seen = np.full(depth.shape, np.float32(np.inf))
    np.minimum.at(seen, (y[inside].astype(int), x[inside].astype(int)), z[inside])
    return np.where(np.isfinite(seen), seen, np.float32(np.nan))
