"""Cameras as the datasets state them."""

import os
import struct
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.formats import FormatError
from tisfm.formats.reading import read_bytes
from tisfm.formats.tagged import TAG

STATED_SIZE = (480, 640)
"""Height and width of the frames that `STATED` is about, px."""

STATED = {
    # Its authors give the focal length of the depth camera alone, 585 px; 525 px is the usual one
    # of the colour camera of that sensor.
    "sevenscenes": Camera(focal=525.0, center=(320.0, 240.0)),
    "new_tsukuba": Camera(focal=615.0, center=(320.0, 240.0)),
}
"""Cameras of layouts that have one for all their frames, which no file says."""

DEPTH_CAMERA = Camera(focal=585.0, center=(320.0, 240.0))
"""The depth camera of "sevenscenes"; its maps and the frames are not of one view."""

COLOUR_OFFSET = 0.025
"""Where the colour camera of that sensor is, to the right of its depth camera, m."""

_CAM = struct.Struct("<f9d12d")  # tag, intrinsics 3×3, extrinsics 3×4


def read_camera(path: Path, frame: Path) -> Camera:
    """Read the camera of a frame.

    Parameters
    ----------
    path : Path
        A Sintel .cam file, or a KITTI calibration text of 2012 or 2015.
    frame : Path
        The frame. In KITTI's folder image_0 it is of the grey camera 0, elsewhere of the colour
        camera 2.

    Returns
    -------
    Camera
        Focal length and principal point, px.

    Raises
    ------
    FormatError
        If the file is damaged, or does not state this camera.
    OSError
        If the file does not exist or cannot be read.
    """
    if path.suffix == ".cam":
        matrix = _sintel_matrix(path)
    else:
        matrix = _kitti_matrix(path, 0 if frame.parent.name == "image_0" else 2)
    try:
        return Camera(focal=float(matrix[0, 0]), center=(float(matrix[0, 2]), float(matrix[1, 2])))
    except ValueError as error:
        raise FormatError(f"{path} states no usable camera: {error}") from error


def for_width(camera: Camera, width: int) -> Camera:
    """Return a camera that is stated for frames of `STATED_SIZE` for these frames resampled."""
    return camera.scaled(width / STATED_SIZE[1], *STATED_SIZE)


def _sintel_matrix(path: Path) -> np.ndarray:
    data = read_bytes(path)
    if len(data) != _CAM.size:
        raise FormatError(f"{path} is no .cam file: {len(data)} bytes, expected {_CAM.size}")
    tag, *numbers = _CAM.unpack(data)
    if tag != TAG:
        raise FormatError(f"{path} is no .cam file: its tag is {tag}, expected {TAG}")
    return np.array(numbers[:9]).reshape(3, 3)


def _kitti_matrix(path: Path, index: int) -> np.ndarray:
    """Return the 3×4 projection of a rectified camera, from the line that holds it."""
    names = (f"P_rect_{index:02d}", f"P{index}")  # of 2015 and 2012
    for line in read_bytes(os.fspath(path)).decode("utf-8", errors="replace").splitlines():
        name, _, values = line.partition(":")
        if name.strip() in names:
            try:
                return np.array([float(value) for value in values.split()]).reshape(3, 4)
            except ValueError as error:
                raise FormatError(
                    f"{path} has a damaged line {name.strip()}: expected 12 numbers"
                ) from error
    raise FormatError(f"{path} has no line {' or '.join(names)}: not a KITTI calibration")
