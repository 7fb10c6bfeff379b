"""ST maps that remove and add the distortion of a lens, for Nuke, Fusion and others."""

import os
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.exports.float_images import check_exr, write_exr, write_tiff
from tisfm.lens import Undistortion

_OUTSIDE = -1.0  # coordinate outside every picture
_MAX_ROUND_TRIP_ERROR = 0.01  # px: error of a point after undistortion and distortion; set by hand
_UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


def write_undistortion(
    camera: Camera,
    shape: tuple[int, int],
    folder: str | os.PathLike[str],
    *,
    suffix: Literal["exr", "tiff"] = "exr",
) -> list[Path]:
    """Write ST maps: ``undistort.exr`` and ``redistort.exr``, or TIFF.

    ``undistort`` has, at a pixel of the undistorted picture, its position in the frame.
    ``redistort`` has, at a pixel of the frame, its position in the undistorted picture. Red
    is the column, from 0 at the left edge to 1 at the right edge; green is the row, from 0 at the
    bottom edge to 1 at the top: the centre of the upper left pixel of W × H is (0.5 / W, 1 − 0.5 /
    H). Blue is 1 for a position inside the picture. Otherwise it is 0, and red and green are −1.

    Parameters
    ----------
    camera : Camera
        Camera of the frames, with distortion or oblong pixels. The undistorted picture has the same
        size, focal length (the smaller of two) and principal point.
    shape : (int, int)
        Height and width of the frames, px.
    folder : path
        It has to exist.
    suffix : {"exr", "tiff"}
        Both have float32; EXR needs ``pip install 'tisfm[export]'``.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ValueError
        If the camera has no distortion, or cannot be the camera of the frames.
    ImportError
        If OpenEXR is not installed.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_undistortion
    >>> camera = tisfm.Camera(focal=60.0, distortion=(-0.1, 0.01, 0, 0))
    >>> [str(file) for file in write_undistortion(camera, (48, 64), ".", suffix="tiff")]
    ['undistort.tiff', 'redistort.tiff']
    """
    require_distortion(camera)
    if suffix == "exr":
        check_exr()
    files = []
    for name, st_map in zip(("undistort", "redistort"), st_maps(camera, shape), strict=True):
        file = Path(folder) / f"{name}.{suffix}"
        if suffix == "exr":
            write_exr(file, {name: st_map[..., k] for k, name in enumerate("RGB")})
        else:
            write_tiff(file, st_map)
        files.append(file)
    return files


def require_distortion(camera: Camera) -> None:
    """Raise ValueError if the camera has no distortion."""
    if camera.is_pinhole:
        raise InputError("the camera has no distortion: there is nothing that a map would undo")


def st_maps(
    camera: Camera, shape: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return both maps as `write_undistortion` describes them, (H, W, 3) float32."""
    height, width = shape
    undistortion = Undistortion(camera, height, width)
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    distorted_points = distort_points(camera, shape, np.stack([x, y], axis=-1))
    undistorted_points = undistort_points(camera, shape, np.stack([x, y], axis=-1))
    round_trip = distort_points(camera, shape, undistorted_points)
    is_accurate = np.hypot(round_trip[..., 0] - x, round_trip[..., 1] - y) < _MAX_ROUND_TRIP_ERROR
    is_valid = is_accurate & _are_inside(undistorted_points, shape)
    column, row = (
        np.rint(undistorted_points[..., k]).clip(0, end - 1)
        for k, end in enumerate((width, height))
    )
    column, row = (np.where(is_valid, st_map, 0).astype(int) for st_map in (column, row))
    is_valid &= undistortion.valid[row, column]
    return _st_map(distorted_points, undistortion.valid, shape), _st_map(
        undistorted_points, is_valid, shape
    )


def distort_points(
    camera: Camera, shape: tuple[int, int], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the positions in the frame of points of the undistorted picture, (…, 2) px."""
    frame_matrix, pinhole_matrix = _matrices(camera, shape)
    rays = (points.reshape(-1, 2) - pinhole_matrix[:2, 2]) / pinhole_matrix[[0, 1], [0, 1]]
    rays_3d = np.column_stack([rays, np.ones(len(rays))])
    positions, _ = cv2.projectPoints(
        rays_3d, np.zeros(3), np.zeros(3), frame_matrix, _coefficients(camera)
    )
    return np.asarray(positions, float).reshape(points.shape)


def undistort_points(
    camera: Camera, shape: tuple[int, int], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the positions in the undistorted picture of points of the frame, (…, 2) px."""
    frame_matrix, pinhole_matrix = _matrices(camera, shape)
    positions = cv2.undistortPoints(
        points.reshape(-1, 1, 2),
        frame_matrix,
        _coefficients(camera),
        P=pinhole_matrix,
        criteria=_UNDISTORT_CRITERIA,
    )
    return np.nan_to_num(np.asarray(positions, float).reshape(points.shape), nan=_OUTSIDE * 1e9)


def _matrices(
    camera: Camera, shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the intrinsics of the frame and of the undistorted picture, (3, 3)."""
    cx, cy = camera.center_for(*shape)
    frame_matrix, pinhole_matrix = (
        np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        for fx, fy in (camera.focals, camera.pinhole().focals)
    )
    return frame_matrix, pinhole_matrix


def _coefficients(camera: Camera) -> NDArray[np.float64]:
    return np.array(camera.distortion or (0.0,) * 4)


def _are_inside(points: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    height, width = shape
    column, row = points[..., 0], points[..., 1]
    return np.asarray(
        (column >= -0.5) & (column <= width - 0.5) & (row >= -0.5) & (row <= height - 0.5)
    )


def _st_map(
    points: NDArray[np.float64], valid: NDArray[np.bool_], shape: tuple[int, int]
) -> NDArray[np.float32]:
    height, width = shape
    st_map = np.stack(
        [(points[..., 0] + 0.5) / width, 1 - (points[..., 1] + 0.5) / height, np.ones(shape)],
        axis=-1,
    )
    st_map[~valid] = (_OUTSIDE, _OUTSIDE, 0)
    return st_map.astype(np.float32)
