"""Camera files: one command writes its camera, and other commands read it."""

import json
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from tisfm.camera import Camera, check_camera
from tisfm.errors import InputError
from tisfm.formats import FormatError, atomic_write
from tisfm.formats.reading import read_json

__all__ = ["read_camera", "write_camera"]

FORMAT = 2  # version of the format
FILE_NAME = "camera.json"  # in the folder of a reconstruction
MAX_SIDE = 2**20  # px: the longest side of a frame that a file may have
# Relative difference of two aspect ratios up to which they count as equal.
MAX_ASPECT_DIFFERENCE = 0.01


def write_camera(
    path: str | os.PathLike[str],
    camera: Camera,
    shape: tuple[int, int],
    about: dict[str, Any] | None = None,
) -> None:
    """Write a camera as JSON; after an error there is no incomplete file.

    Parameters
    ----------
    path : path
    camera : Camera
    shape : (int, int)
        Height and width of its frames, px.
    about : dict, optional
        More entries for the file; `read_camera` ignores them.

    Raises
    ------
    OSError
        If the file cannot be written.
    TypeError, ValueError
        If `camera` is not a camera, or `shape` is not a shape.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.camera_file import read_camera, write_camera
    >>> write_camera("camera.json", tisfm.Camera(focal=720.0), (480, 640))
    >>> read_camera("camera.json").focal
    720.0
    """
    camera = check_camera(camera)
    height, width = (int(side) for side in shape)
    if height < 1 or width < 1:
        raise InputError(f"shape is {shape}: expected (height, width)")
    record = {**(about or {}), "format": FORMAT, "width": width, "height": height, **asdict(camera)}
    with atomic_write(path) as file:
        file.write((json.dumps(record, indent=1) + "\n").encode())


def read_camera(path: str | os.PathLike[str], shape: tuple[int, int] | None = None) -> Camera:
    """Read a camera that `write_camera` or ``tisfm reconstruct`` wrote.

    Parameters
    ----------
    path : path
        The file, or the folder of a reconstruction.
    shape : (int, int), optional
        Height and width of the frames for which the camera is needed, px. If these are enlarged or
        shrunk frames of the file's camera, the camera is scaled accordingly.

    Returns
    -------
    Camera

    Raises
    ------
    FileNotFoundError, OSError
        If the file does not exist or cannot be read.
    tisfm.formats.FormatError
        A ValueError: if the file does not hold a camera.
    ValueError
        If the camera belongs to frames with another aspect ratio.

    Examples
    --------
    >>> from tisfm.camera_file import read_camera
    >>> read_camera("walk").focal  # of the frames that were reconstructed, 180 × 240 px
    144.0
    >>> read_camera("walk", shape=(360, 480)).focal  # of larger frames from the same lens
    288.0
    """
    file = camera_file_path(path)
    record = read_camera_record(file)
    try:
        if record["format"] != FORMAT:
            raise InputError(
                f"it is of format {record['format']}, this version reads {FORMAT}: make it anew, "
                "with tisfm reconstruct or write_camera"
            )
        height, width = record["height"], record["width"]
        if not all(type(side) is int and 1 <= side <= MAX_SIDE for side in (height, width)):
            raise InputError(f"its frames are {width}×{height}")
        center = record["center"]
        camera = check_camera(
            Camera(
                focal=record["focal"],
                center=None if center is None else tuple(center),
                distortion=record["distortion"],
                aspect=record["aspect"],
                readout=record["readout"],
            )
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise FormatError(f"{file} is not a camera file: {reason}") from error
    if shape is None or tuple(shape) == (height, width):
        return camera
    ratios = shape[0] / height, shape[1] / width
    if abs(ratios[0] / ratios[1] - 1) > MAX_ASPECT_DIFFERENCE:
        raise InputError(
            f"{file} is the camera of frames of {width}×{height} px, not of {shape[1]}×{shape[0]}: "
            "give the camera of frames with that aspect ratio"
        )
    scaled_camera = camera.scaled(ratios[1], height, width)
    return scaled_camera if camera.center is not None else replace(scaled_camera, center=None)


def focal_doubt(path: str | os.PathLike[str]) -> str:
    """Return why the focal length in a camera file is doubtful, or "" if it is reliable."""
    record = read_camera_record(path)
    return "" if record.get("seen", True) else str(record.get("message", ""))


def read_camera_record(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return all entries of a camera file."""
    file = camera_file_path(path)
    try:
        record = read_json(file)
    except FormatError as error:
        reason = str(error).removeprefix(f"{file} ")
        raise FormatError(f"{file} is not a camera file: {reason}") from error
    if not isinstance(record, dict):
        raise FormatError(f"{file} is not a camera file: it does not hold an object of JSON")
    return record


def camera_file_path(path: str | os.PathLike[str]) -> Path:
    """Return the camera file; the path may also be the folder that holds it."""
    return Path(path) / FILE_NAME if Path(path).is_dir() else Path(path)
