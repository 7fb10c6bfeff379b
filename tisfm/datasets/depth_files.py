"""True depth: depth maps of depth cameras, and disparities of stereo pairs."""

import io
import math
import os
import zipfile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.formats import FormatError, read_image
from tisfm.formats.image_headers import MAX_IMAGE_PIXELS
from tisfm.formats.npz import ALLOWED_COMPRESSIONS, DAMAGE_ERRORS
from tisfm.formats.reading import read_bytes

MM_PER_METRE = 1000.0
"""Scale of a depth map in millimetres: file values per metre."""

_VALUES_WITHOUT_DEPTH = (0, 65535)  # file values without a depth


def read_depth(
    path: str | os.PathLike[str],  # a 16-bit grey image, 0 or 65535 where there is no depth
    # file values per unit of depth. By default the file is in millimetres, the
    # depth in metres.
    scale: float = MM_PER_METRE,
) -> NDArray[np.float32]:  # (H, W) float32 ndarray: depth Z; NaN where there is no depth
    """Read a depth map.

    Raises FormatError if the file is damaged, or not an (H, W) image of 16 bits.

    Raises OSError if the file does not exist or cannot be read.
    """
    pixels = read_image(path)
    if pixels.ndim != 2 or pixels.dtype != np.uint16:
        raise FormatError(
            f"{os.fspath(path)} holds {pixels.shape} {pixels.dtype}, expected a depth map, (H, W) "
            "uint16"
        )
    depth = pixels.astype(np.float32) / np.float32(scale)
    depth[np.isin(pixels, _VALUES_WITHOUT_DEPTH)] = np.nan
    return depth


def reproject_depth(
    # (H, W) float32: Z in the axes of the source camera, NaN where there is no depth
    depth: NDArray[np.float32],
    # source, target: the camera of the map, and the camera beside it, with the same direction and
    # image size. A target with a longer focal length would get gaps.
    source: Camera,
    target: Camera,
    # X of the target camera in the axes of the source camera, in the unit of the depth
    offset: float,
) -> NDArray[np.float32]:
    """Project a depth map into the image of a camera beside the camera that took it.

    Returns (H, W) float32, the depth of the nearest surface that falls on each pixel of the target;
    NaN for pixels without a surface.
    """
    height, width = depth.shape
    rows, columns = np.nonzero(np.isfinite(depth) & (depth > 0))
    z = depth[rows, columns]
    (cx, cy), (x0, y0) = (camera.center_for(height, width) for camera in (source, target))
    ratio = target.focal / source.focal
    x = np.rint((columns - cx) * ratio - target.focal * offset / z + x0)
    y = np.rint((rows - cy) * ratio + y0)
    is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    target_depth = np.full(depth.shape, np.float32(np.inf))
    np.minimum.at(target_depth, (y[is_inside].astype(int), x[is_inside].astype(int)), z[is_inside])
    return np.where(np.isfinite(target_depth), target_depth, np.float32(np.nan))


_KITTI_STEPS = 256  # 16-bit file values per pixel of disparity
_ZIP_SIGNATURE = b"PK"  # first bytes of .npz files
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_disparity(
    # An image: uint8 in px, or uint16 in px / 256 as in KITTI, both 0 where unknown; or float in
    # px. Or an .npy or .npz file with one such array.
    path: str | os.PathLike[str],
) -> NDArray[np.float32]:
    """Read the disparity of the left view of a stereo pair.

    Returns (H, W) float32, the disparity x_left − x_right, px; NaN where the file has 0 (integers)
    or a value that is not finite (floats).

    Raises FormatError if the file is damaged, or does not hold one (H, W) map of these types.

    Raises OSError if the file does not exist or cannot be read.

    Raises MemoryError if memory does not suffice for the map.
    """
    name = os.fspath(path)
    pixels = _read_array(name) if name.lower().endswith((".npy", ".npz")) else read_image(name)
    _check_map(name, pixels.shape, pixels.dtype)
    if pixels.dtype.kind == "f":
        return np.where(np.isfinite(pixels), pixels, np.nan).astype(np.float32)
    disparity = pixels.astype(np.float32)
    if pixels.dtype == np.uint16:
        disparity /= np.float32(_KITTI_STEPS)
    disparity[pixels == 0] = np.nan
    return disparity


def _read_array(name: str) -> NDArray[Any]:
    """Return the only array of an .npy or .npz file; its header is checked before unpacking."""
    data = read_bytes(name)
    try:
        if not data.startswith(_ZIP_SIGNATURE):
            return _read_npy(name, io.BytesIO(data), len(data))
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            parts = archive.infolist()
            if len(parts) != 1:
                raise FormatError(f"{name} holds {len(parts)} arrays, expected one: the disparity")
            if parts[0].compress_type not in ALLOWED_COMPRESSIONS:
                raise FormatError(
                    f"{name} has a compression that NumPy does not write: save it with NumPy"
                )
            with archive.open(parts[0]) as part:
                return _read_npy(name, part, parts[0].file_size)
    except FormatError:
        raise
    except DAMAGE_ERRORS as error:
        reason = " ".join(str(error).split())
        raise FormatError(f"{name} cannot be read as NumPy arrays: {reason}") from error


def _read_npy(name: str, file: IO[bytes], length: int) -> NDArray[Any]:
    """Return the array of an .npy file of `length` bytes."""
    version = np.lib.format.read_magic(file)
    if version not in _HEADER_READERS:
        raise InputError(f"its header is of version {version}")
    shape, is_by_columns, dtype = _HEADER_READERS[version](file)
    _check_map(name, shape, dtype)
    expected, remaining = math.prod(shape) * dtype.itemsize, length - file.tell()
    if remaining != expected:
        raise FormatError(
            f"{name} is damaged: {remaining} bytes of numbers, expected {expected} for "
            f"{shape} {dtype}"
        )
    numbers = file.read(expected)
    file.read(1)  # zipfile compares the check sum at the end
    return np.frombuffer(numbers, dtype).reshape(shape, order="F" if is_by_columns else "C")


def _check_map(name: str, shape: tuple[int, ...], dtype: np.dtype) -> None:
    if len(shape) == 2 and math.prod(shape) > MAX_IMAGE_PIXELS:
        raise FormatError(
            f"{name} has {math.prod(shape):,} values, of shape {shape}: expected at most "
            f"{MAX_IMAGE_PIXELS:,}; shrink the map"
        )
    if len(shape) != 2 or min(shape) < 1:
        raise FormatError(f"{name} holds {shape}, expected a disparity map, (H, W)")
    if dtype.kind != "f" and dtype not in (np.uint8, np.uint16):
        raise FormatError(f"{name} holds {dtype}, expected uint8, uint16 or float")
