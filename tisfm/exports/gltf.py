"""A glTF 2.0 document with one moving camera."""

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tisfm.version import __version__

_FLOAT = 5126  # code of float32 in glTF
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}  # type of an accessor by its number of columns
_NEAR_PLANE = 0.01  # in the unit of the poses; set by hand


def camera_document(
    # (N, 4, 4) float64: camera to world, Y up, the camera looks along −Z
    poses: NDArray[np.float64],
    times: NDArray[np.float64],  # (N,) float64: s, strictly rising
    *,
    vertical_angle: float,  # vertical field of view, rad
    aspect: float,  # width of the frames over height
    about: dict[str, Any],  # further properties of the camera, for its ``extras``
) -> bytes:
    """Return a glTF document that contains its binary data.

    References
    ----------
    The Khronos Group, glTF 2.0 Specification, 2021 (ISO/IEC 12113).
    """
    turns = _continuous(Rotation.from_matrix(poses[:, :3, :3]).as_quat())
    arrays = [values.astype("<f4") for values in (times[:, None], poses[:, :3, 3], turns)]
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    start = 0
    for values in arrays:
        views.append({"buffer": 0, "byteOffset": start, "byteLength": values.nbytes})
        accessors.append(
            {
                "bufferView": len(accessors),
                "componentType": _FLOAT,
                "count": len(values),
                "type": _KINDS[values.shape[1]],
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
        "cameras": [{"type": "perspective", "perspective": lens, "extras": about}],
        "animations": [{"name": "path", "samplers": samplers, "channels": channels}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [
            {"byteLength": start, "uri": f"data:application/octet-stream;base64,{content}"}
        ],
    }
    return json.dumps(document, allow_nan=False).encode()


def _continuous(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same rotations with signs that make neighbouring quaternions similar.

    Both signs mean the same rotation, but programs interpolate the numbers.
    """
    products = (quaternions[1:] * quaternions[:-1]).sum(axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0, -1.0, 1.0)]))
    return np.asarray(quaternions * signs[:, None])
