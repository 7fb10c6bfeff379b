"""Poses and lens in the axes of modellers: Y up, the camera looks along −Z."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # of Y and Z, which is its own inverse
SENSOR = 36.0  # mm: the width that a focal length in mm is told for
_CENTERED = 0.5  # px


def y_up(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses whose world has Y up, and whose camera looks along −Z with Y up.

    Parameters
    ----------
    poses : (N, 4, 4) float64
        Camera to world, X right, Y down, Z forward, in both.

    Returns
    -------
    (N, 4, 4) float64
    """
    return np.asarray(FLIP @ poses @ FLIP)


def vertical_angle(camera: Camera, height: int) -> float:
    """Return the angle, rad, that the frames see from the upper edge to the lower one."""
    return 2 * math.atan2(height / 2, camera.focal)


def is_centered(camera: Camera, shape: tuple[int, int]) -> bool:
    """Return whether the principal point is in the middle of the frame, to half a pixel."""
    height, width = shape
    cx, cy = camera.center_for(height, width)
    return max(abs(cx - (width - 1) / 2), abs(cy - (height - 1) / 2)) <= _CENTERED


def lens_record(camera: Camera, shape: tuple[int, int]) -> dict[str, Any]:
    """Return the lens in the numbers that Blender and Nuke ask for.

    Parameters
    ----------
    camera : Camera
        Without distortion.
    shape : (int, int)
        Height and width of its frames, px.

    Returns
    -------
    dict
        ``width``, ``height``, ``focal`` and ``center``, px, in the coordinates of array indices;
        ``vertical_angle`` and ``horizontal_angle``, degrees; ``blender``: ``sensor_width`` and
        ``lens``, mm, for the sensor fit HORIZONTAL, with ``shift_x`` and ``shift_y``, in widths;
        ``nuke``: ``focal``, ``haperture`` and ``vaperture``, mm, and ``win_translate``, right and
        up, in halves of the width.
    """
    height, width = shape
    cx, cy = camera.center_for(height, width)
    length = SENSOR * camera.focal / width
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
            "sensor_width": SENSOR,
            "lens": length,
            "shift_x": shift[0],
            "shift_y": shift[1],
        },
        "nuke": {
            "focal": length,
            "haperture": SENSOR,
            "vaperture": SENSOR * height / width,
            "win_translate": [2 * part for part in shift],
        },
    }
