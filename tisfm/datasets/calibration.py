"""Cameras as the datasets state them."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.formats import FormatError
from tisfm.formats.float_maps import TAG
from tisfm.formats.reading import read_bytes, read_text

STATED_SIZE = (480, 640)
"""Height and width of the frames that `STATED` is about, px."""

STATED = {
    # Its authors give the focal length of the depth camera alone, 585 px; 525 px is the usual one
    # of the colour camera of that sensor.
    "sevenscenes": Camera(focal=525.0, center=(320.0, 240.0)),
    "new_tsukuba": Camera(focal=615.0, center=(320.0, 240.0)),
}
"""Cameras of layouts that have one for all their frames, which no file says."""

TUM = {
    "1": Camera(
        focal=(517.3, 516.5),
        center=(318.6, 255.3),
        distortion=(0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    ),
    "2": Camera(
        focal=(520.9, 521.0),
        center=(325.1, 249.7),
        distortion=(0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    ),
    "3": Camera(focal=(535.4, 539.2), center=(320.1, 247.6)),
}
"""Colour cameras of TUM's sequences, by the number after "freiburg" in the folder's name."""

DEPTH_CAMERA = Camera(focal=585.0, center=(320.0, 240.0))
"""The depth camera of "sevenscenes"; its maps and the frames are not of one view."""

COLOUR_OFFSET = 0.025
"""Where the colour camera of that sensor is, to the right of its depth camera, m."""

_NAMES = ("fx", "fy", "cx", "cy")
_LENS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
_DEPTH_SCALE = "depth_scale"
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


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a sequence says about its camera.

    Attributes
    ----------
    camera : Camera or None
        None where nothing says what it is.
    depth_scale : float or None
        Values of its depth maps per unit of depth, if it says so.
    """

    camera: Camera | None
    depth_scale: float | None = None


def read_calibration(path: Path) -> Calibration:
    """Read the camera of a sequence from a text with a heading and a line of numbers.

    Parameters
    ----------
    path : Path
        The heading names the numbers, in any order: fx, fy, cx and cy, px; OpenCV's coefficients
        of distortion k1, k2, p1, p2, k3, … as far as there are any; and depth_scale.

    Returns
    -------
    Calibration

    Raises
    ------
    FormatError
        If the file is of another kind, or states no usable camera.
    OSError
        If the file does not exist or cannot be read.
    """
    lines = read_text(path).splitlines()
    rows = [line.split() for line in lines if line.strip()]
    if len(rows) != 2 or len(rows[0]) != len(rows[1]):
        raise FormatError(
            f"{path} is no calibration: expected a heading such as {' '.join(_NAMES)} and below "
            "it as many numbers"
        )
    names, words = rows
    unknown = sorted(set(names).difference(_NAMES, _LENS, [_DEPTH_SCALE]))
    missing = [name for name in _NAMES if name not in names]
    if unknown or missing or len(set(names)) < len(names):
        raise FormatError(
            f"{path} has the heading {' '.join(names)}: expected each of {' '.join(_NAMES)} once, "
            f"and of {' '.join((*_LENS, _DEPTH_SCALE))} what there is"
        )
    try:
        values = {name: float(word) for name, word in zip(names, words, strict=True)}
    except ValueError as error:
        raise FormatError(f"{path}: {error}, expected numbers") from error
    lens = [name for name in _LENS if name in values]
    if tuple(lens) != _LENS[: len(lens)]:
        raise FormatError(f"{path} has {' '.join(lens)}, but not all that come before the last")
    scale = values.get(_DEPTH_SCALE)
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise FormatError(f"{path} has the {_DEPTH_SCALE} {scale:g}, expected a positive number")
    try:
        camera = Camera(
            focal=(values["fx"], values["fy"]),
            center=(values["cx"], values["cy"]),
            distortion=[values[name] for name in lens] or None,
        )
    except ValueError as error:
        raise FormatError(f"{path} states no usable camera: {error}") from error
    return Calibration(camera=camera, depth_scale=scale)


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
    for line in read_text(path).splitlines():
        name, _, values = line.partition(":")
        if name.strip() in names:
            try:
                return np.array([float(value) for value in values.split()]).reshape(3, 4)
            except ValueError as error:
                raise FormatError(
                    f"{path} has a damaged line {name.strip()}: expected 12 numbers"
                ) from error
    raise FormatError(f"{path} has no line {' or '.join(names)}: not a KITTI calibration")
