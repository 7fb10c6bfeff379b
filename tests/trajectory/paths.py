"""Paths of cameras that tests make."""

import numpy as np
from hypothesis import settings

from tisfm.rigid import pose_matrix

# Of tests with drawn examples.
PATIENT = settings(max_examples=50)


def random_path(rng, count, *, length=1.0, turn=0.3, missing=()):
    """Return poses, (count, 4, 4), each a random motion after the one before."""
    poses = [np.eye(4)]
    for _ in range(count - 1):
        twist = [*rng.normal(0, length, 3), *rng.normal(0, turn, 3)]
        poses.append(poses[-1] @ pose_matrix(twist))
    path = np.array(poses)
    path[list(missing)] = np.nan
    return path


def similar(path, scale, rotation, translation):
    """Return a path in another world: rotated, scaled and moved."""
    moved = path.copy()
    moved[:, :3, :3] = rotation @ path[:, :3, :3]
    moved[:, :3, 3] = scale * path[:, :3, 3] @ rotation.T + translation
    return moved
