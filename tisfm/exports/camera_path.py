"""The moving camera for Blender and Nuke, and its lens: Y up, the camera looks along −Z."""

import base64
import json
import math
import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tisfm.camera import Camera
from tisfm.exports.export_request import frame_rate, piece_files, piece_frames, select_frames
from tisfm.formats import atomic_write
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.version import __version__

_FLOAT32_CODE = 5126  # code of float32 in glTF
_ACCESSOR_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}  # by the number of columns
_NEAR_PLANE = 0.01  # in the unit of the poses; set by hand


def camera_document(
    # (N, 4, 4) float64: camera to world, Y up, the camera looks along −Z
    poses: NDArray[np.float64],
    times: NDArray[np.float64],  # (N,) float64: s, strictly rising
    *,
    vertical_angle: float,  # vertical field of view, rad
    aspect: float,  # width of the frames over height
    extras: dict[str, Any],  # further properties of the camera, for its ``extras``
) -> bytes:
    """Return a glTF document that contains its binary data.

    References
    ----------
    The Khronos Group, glTF 2.0 Specification, 2021 (ISO/IEC 12113).
    """
    quaternions = _align_signs(Rotation.from_matrix(poses[:, :3, :3]).as_quat())
    arrays = [values.astype("<f4") for values in (times[:, None], poses[:, :3, 3], quaternions)]
    buffer_views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    start = 0
    for values in arrays:
        buffer_views.append({"buffer": 0, "byteOffset": start, "byteLength": values.nbytes})
        accessors.append(
            {
                "bufferView": len(accessors),
                "componentType": _FLOAT32_CODE,
                "count": len(values),
                "type": _ACCESSOR_TYPES[values.shape[1]],
                "min": values.min(axis=0).tolist(),
                "max": values.max(axis=0).tolist(),
            }
        )
        start += values.nbytes
    content = base64.b64encode(b"".join(values.tobytes() for values in arrays)).decode()
    lens = {"yfov": vertical_angle, "aspectRatio": aspect, "znear": _NEAR_PLANE}
    samplers = [{"input": 0, "output": k, "interpolation": "LINEAR"} for k in (1, 2)]
    channels = [
        {"sampler": k, "target": {"node": 0, "path": path}}
        for k, path in enumerate(("translation", "rotation"))
    ]
    node = {
        "name": "camera",
        "camera": 0,
        "translation": arrays[1][0].tolist(),
        "rotation": arrays[2][0].tolist(),
    }
    document = {
        "asset": {"version": "2.0", "generator": f"tisfm {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "cameras": [{"type": "perspective", "perspective": lens, "extras": extras}],
        "animations": [{"name": "path", "samplers": samplers, "channels": channels}],
        "accessors": accessors,
        "bufferViews": buffer_views,
        "buffers": [
            {"byteLength": start, "uri": f"data:application/octet-stream;base64,{content}"}
        ],
    }
    return json.dumps(document, allow_nan=False).encode()


def _align_signs(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same rotations with signs that make neighbouring quaternions similar.

    Both signs mean the same rotation, but programs interpolate the numbers.
    """
    products = (quaternions[1:] * quaternions[:-1]).sum(axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0, -1.0, 1.0)]))
    return np.asarray(quaternions * signs[:, None])


FLIP_Y_Z = np.diag([1.0, -1.0, -1.0, 1.0])  # changes the sign of Y and Z; it is its own inverse
SENSOR_WIDTH = 36.0  # mm, width of the sensor that a focal length in mm refers to: full frame
_MAX_CENTER_OFFSET = 0.5  # px of the principal point from the middle of the frame; set by hand


def y_up(
    # (N, 4, 4) float64: camera to world; camera and world have X right, Y down, Z forward
    poses: NDArray[np.float64],
) -> NDArray[np.float64]:  # (N, 4, 4) float64
    """Return poses in a world with Y up, of a camera that looks along −Z with Y up."""
    return np.asarray(FLIP_Y_Z @ poses @ FLIP_Y_Z)


def vertical_angle(camera: Camera, height: int) -> float:
    """Return the vertical field of view of the frames, rad."""
    return 2 * math.atan2(height / 2, camera.focal)


def is_centered(camera: Camera, shape: tuple[int, int]) -> bool:
    """Return whether the principal point is within half a pixel of the middle of the frame."""
    height, width = shape
    cx, cy = camera.center_for(height, width)
    return max(abs(cx - (width - 1) / 2), abs(cy - (height - 1) / 2)) <= _MAX_CENTER_OFFSET


def lens_record(
    camera: Camera,  # without distortion
    shape: tuple[int, int],  # height and width of its frames, px
) -> dict[str, Any]:
    """Return the lens in the units of Blender and Nuke.

    Returns ``width``, ``height``, ``focal`` and ``center``, px, in the coordinates of array
    indices; ``vertical_angle`` and ``horizontal_angle``, degrees; ``blender``: ``sensor_width`` and
    ``lens``, mm, for the sensor fit HORIZONTAL, with ``shift_x`` and ``shift_y``, in widths;
    ``nuke``: ``focal``, ``haperture`` and ``vaperture``, mm, and ``win_translate``, right and up,
    in halves of the width.
    """
    height, width = shape
    cx, cy = camera.center_for(height, width)
    focal_mm = SENSOR_WIDTH * camera.focal / width
    shift = ((width - 1) / 2 - cx) / width, (cy - (height - 1) / 2) / width
    return {
        "width": width,
        "height": height,
        "focal": camera.focal,
        "center": [cx, cy],
        "vertical_angle": math.degrees(vertical_angle(camera, height)),
        "horizontal_angle": math.degrees(vertical_angle(camera, width)),
        "blender": {
            "sensor_fit": "HORIZONTAL",
            "sensor_width": SENSOR_WIDTH,
            "lens": focal_mm,
            "shift_x": shift[0],
            "shift_y": shift[1],
        },
        "nuke": {
            "focal": focal_mm,
            "haperture": SENSOR_WIDTH,
            "vaperture": SENSOR_WIDTH * height / width,
            "win_translate": [2 * part for part in shift],
        },
    }


GLTF, CHAN, LENS = "camera.gltf", "camera.chan", "lens.json"


def write_gltf_cameras(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    frames: Iterable[int] | None = None,
    frames_per_second: float | None = None,
) -> list[Path]:
    """Write the camera as an animation, ``camera.gltf``, and its lens, ``lens.json``.

    Y points up, the camera looks along −Z, as in the GLB files of points and meshes. Frame n is
    shown at n / `frames_per_second` seconds; between frames with a pose, programs interpolate.

    Parameters
    ----------
    result : Reconstruction
    folder : path
        It has to exist. Each piece of a sequence has its own file, as in `write_tum_paths`.
    frames : iterable of int, optional
        Numbers of frames; by default all.
    frames_per_second : float, optional
        By default from the times of the source, or 25.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ValueError, IndexError
        If no frame has a pose, a frame does not exist, or the frame rate is out of range.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_gltf_cameras
    >>> [str(file) for file in write_gltf_cameras(tisfm.Reconstruction.load("walk"), ".")]
    ['camera.gltf', 'lens.json']
    """
    chosen = select_frames(frames, len(result))
    pieces = piece_frames(result, chosen)
    rate = frame_rate(result.times, range(len(result)), frames_per_second)
    height, width = result.shape
    files = piece_files(Path(folder), GLTF, pieces)
    extras = {**lens_record(result.camera, result.shape), "frames_per_second": rate}
    for file, piece in zip(files, pieces, strict=True):
        document = camera_document(
            y_up(result.poses[piece]),
            np.array(piece) / rate,
            vertical_angle=vertical_angle(result.camera, height),
            aspect=width / height,
            extras=extras | ({"note": note} if (note := result.warning(piece)) else {}),
        )
        with atomic_write(file) as stream:
            stream.write(document)
    return [*files, _write_lens(result, Path(folder))]


def write_chan(
    result: Reconstruction, folder: str | os.PathLike[str], *, frames: Iterable[int] | None = None
) -> list[Path]:
    """Write the camera as Nuke reads it, ``camera.chan``, and its lens, ``lens.json``.

    A line has frame tx ty tz rx ry rz vfov. Y points up, the camera looks along −Z. Angles are in
    degrees, in the rotation order ZXY: about Z first, then X, then Y. Frames are counted from 0; a
    frame without a pose has no line.

    Parameters
    ----------
    result, folder, frames
        As for `write_gltf_cameras`.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ValueError, IndexError, OSError
        As for `write_gltf_cameras`.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_chan
    >>> [str(file) for file in write_chan(tisfm.Reconstruction.load("walk"), ".")]
    ['camera.chan', 'lens.json']
    """
    pieces = piece_frames(result, frames)
    angle = math.degrees(vertical_angle(result.camera, result.shape[0]))
    files = piece_files(Path(folder), CHAN, pieces)
    for file, piece in zip(files, pieces, strict=True):
        poses = y_up(result.poses[piece])
        rows = np.column_stack([poses[:, :3, 3], _zxy_degrees(poses[:, :3, :3])]).tolist()
        text = "".join(
            f"{frame} {' '.join(map(repr, row))} {angle!r}\n"
            for frame, row in zip(piece, rows, strict=True)
        )
        with atomic_write(file) as stream:
            stream.write(text.encode())
    return [*files, _write_lens(result, Path(folder))]


def _zxy_degrees(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles rx, ry, rz of R = Ry Rx Rz, (N, 3), degrees, without jumps of a turn."""
    with warnings.catch_warnings():  # looking straight up, SciPy warns that angles are not unique
        warnings.simplefilter("ignore", UserWarning)
        angles = Rotation.from_matrix(rotations).as_euler("YXZ")
    return np.degrees(np.unwrap(angles, axis=0)[:, [1, 0, 2]])


def _write_lens(result: Reconstruction, folder: Path) -> Path:
    file = folder / LENS
    with atomic_write(file) as stream:
        stream.write((json.dumps(lens_record(result.camera, result.shape), indent=1)).encode())
    return file
