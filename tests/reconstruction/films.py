"""Films of a room, small, with exact truth."""

from functools import cache

import numpy as np

from tisfm.rigid import pose_matrix
from tisfm.scenes import room_film

STEP = np.array((0.12, 0.0, 0.05, 0.0, 0.012, 0.0))  # of the camera, m and rad a frame


def along(count, step=STEP):
    """Return the poses of a camera that goes on by the same motion in every frame."""
    return np.array([pose_matrix(k * np.asarray(step)) for k in range(count)])


@cache
def walk(count=9, height=180, width=240):
    """Return a film of so many frames."""
    return room_film(along(count), height, width, samples=2)


def path_error(found, true):
    """Return the rmse of camera centres after a similarity, over the length of the true path."""
    from tisfm.metrics import absolute_errors, path_length

    return absolute_errors(found, true).similarity / path_length(true)


def depth_error(depth, true, scale=1.0):
    """Return the mean relative error of a depth map; what has none counts as 1."""
    error = np.abs(scale * depth - true) / true
    return float(np.nan_to_num(error, nan=1.0).mean())
