"""Cameras of the datasets, from their files or from publications."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.formats import FormatError
from tisfm.formats.float_maps import TAG
from tisfm.formats.reading import read_bytes, read_text

KNOWN_CAMERA_SIZE = (480, 640)
"""Height and width of the frames that `KNOWN_CAMERAS` are for, px."""

KNOWN_CAMERAS = {
    # The authors publish only the focal length of the depth camera, 585 px; 525 px is the usual
    # value of the colour camera of that sensor.
    "sevenscenes": Camera(focal=525.0, center=(320.0, 240.0)),
    "new_tsukuba": Camera(focal=615.0, center=(320.0, 240.0)),
}
"""Cameras of layouts that have one camera for all frames, and no file for it."""

TUM_CAMERAS = {
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
"""The depth camera of "sevenscenes". It is beside the colour camera of the frames."""

COLOUR_CAMERA_OFFSET = 0.025
"""Distance of the colour camera of that sensor to the right of its depth camera, m."""

_INTRINSIC_NAMES = ("fx", "fy", "cx", "cy")
# OpenCV's coefficients of distortion, in OpenCV's order.
_DISTORTION_NAMES = (
    "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty",
)  # fmt: skip
_DEPTH_SCALE_NAME = "depth_scale"
_SINTEL_CAMERA = struct.Struct("<f9d12d")  # tag, intrinsics 3×3, extrinsics 3×4


def read_camera(path: Path, frame: Path) -> Camera:
    """Read the camera of a frame.

    Parameters
    ----------
    path : Path
        A Sintel .cam file, or a KITTI calibration text of 2012 or 2015.
    frame : Path
        The frame. KITTI's folder image_0 has the images of the grey camera 0, other folders those
        of the colour camera 2.

    Returns
    -------
    Camera
        Focal length and principal point, px.

    Raises
    ------
    FormatError
        If the file is damaged, or does not have this camera.
    OSError
        If the file does not exist or cannot be read.
    """
    if path.suffix == ".cam":
        matrix = _read_sintel_matrix(path)
    else:
        matrix = _read_kitti_matrix(path, 0 if frame.parent.name == "image_0" else 2)
    try:
        return Camera(focal=float(matrix[0, 0]), center=(float(matrix[0, 2]), float(matrix[1, 2])))
    except ValueError as error:
        raise FormatError(f"{path} states no usable camera: {error}") from error


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """The camera of a sequence, and the scale of its depth maps."""

    camera: Camera | None  # none if unknown
    depth_scale: float | None = None  # values of the depth maps per unit of depth; None if unknown


def read_calibration(
    # the heading names the numbers, in any order: fx, fy, cx and cy, px; optionally the first of
    # OpenCV's coefficients of distortion k1, k2, p1, p2, k3, …; and optionally depth_scale
    path: Path,
) -> Calibration:
    """Read the camera of a sequence from a text with a heading and a line of numbers.

    Raises FormatError if the file has another structure, or the camera is not valid.

    Raises OSError if the file does not exist or cannot be read.
    """
    lines = read_text(path).splitlines()
    rows = [line.split() for line in lines if line.strip()]
    if len(rows) != 2 or len(rows[0]) != len(rows[1]):
        raise FormatError(
            f"{path} is not a calibration: expected a heading such as {' '.join(_INTRINSIC_NAMES)} "
            "and below it as many numbers"
        )
    names, words = rows
    unknown_names = sorted(
        set(names).difference(_INTRINSIC_NAMES, _DISTORTION_NAMES, [_DEPTH_SCALE_NAME])
    )
    missing_names = [name for name in _INTRINSIC_NAMES if name not in names]
    if unknown_names or missing_names or len(set(names)) < len(names):
        raise FormatError(
            f"{path} has the heading {' '.join(names)}: expected each of "
            f"{' '.join(_INTRINSIC_NAMES)} once, and optionally "
            f"{' '.join((*_DISTORTION_NAMES, _DEPTH_SCALE_NAME))}"
        )
    try:
        values = {name: float(word) for name, word in zip(names, words, strict=True)}
    except ValueError as error:
        raise FormatError(f"{path}: {error}, expected numbers") from error
    coefficients = [name for name in _DISTORTION_NAMES if name in values]
    if tuple(coefficients) != _DISTORTION_NAMES[: len(coefficients)]:
        raise FormatError(
            f"{path} has {' '.join(coefficients)}: expected "
            f"{' '.join(_DISTORTION_NAMES[: len(coefficients)])}, the first coefficients without "
            "a gap"
        )
    scale = values.get(_DEPTH_SCALE_NAME)
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise FormatError(
            f"{path} has the {_DEPTH_SCALE_NAME} {scale:g}, expected a positive number"
        )
    try:
        camera = Camera(
            focal=(values["fx"], values["fy"]),
            center=(values["cx"], values["cy"]),
            distortion=[values[name] for name in coefficients] or None,
        )
    except ValueError as error:
        raise FormatError(f"{path} states no usable camera: {error}") from error
    return Calibration(camera=camera, depth_scale=scale)


def scale_known_camera(camera: Camera, width: int) -> Camera:
    """Return one of `KNOWN_CAMERAS` for frames that are resampled to this width, px."""
    return camera.scaled(width / KNOWN_CAMERA_SIZE[1], *KNOWN_CAMERA_SIZE)


def _read_sintel_matrix(path: Path) -> np.ndarray:
    data = read_bytes(path)
    size = _SINTEL_CAMERA.size
    if len(data) != size:
        raise FormatError(f"{path} is not a .cam file: {len(data)} bytes, expected {size}")
    tag, *numbers = _SINTEL_CAMERA.unpack(data)
    if tag != TAG:
        raise FormatError(f"{path} is not a .cam file: its tag is {tag}, expected {TAG}")
    return np.array(numbers[:9]).reshape(3, 3)


def _read_kitti_matrix(path: Path, index: int) -> np.ndarray:
    """Return the 3×4 projection matrix of a rectified camera."""
    names = (f"P_rect_{index:02d}", f"P{index}")  # of KITTI 2015 and 2012
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
