"""Frames and exact poses of a camera that walks through a rendered room."""

import cv2
import numpy as np

from tests.rendered import shared
from tisfm import Camera, scenes

SIZE, SMALL = (240, 320), (180, 240)  # of frames, px
CAMERA, SMALL_CAMERA = (Camera(focal=0.6 * width) for _, width in (SIZE, SMALL))


def pose(forward=0.0, sideways=0.0, turn=0.0):
    """Return a pose, (4, 4) camera to world: m, m and rad."""
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array([0.0, turn, 0.0]))[0]
    matrix[:3, 3] = sideways, 0, forward
    return matrix


@shared
def _view(seed, forward, sideways, turn, height, width):
    at = pose(forward, sideways, turn)
    # The exponential of this twist is the pose: its translation is linear in V.
    columns = [scenes.rigid_motion((*axis, 0, turn, 0))[1] for axis in np.eye(3)]
    velocity = np.linalg.solve(np.transpose(columns), at[:3, 3])
    moved = scenes.room(
        height, width, seed=seed, camera_motion=(*velocity, 0, turn, 0), noise=0, samples=2
    )
    return moved.frame1


def frames(steps, *, seed=0, noise=1.0, size=SIZE):
    """Return frames, (H, W) uint8, taken from steps, each (forward, sideways, turn)."""
    random = np.random.default_rng(seed)
    seen = []
    for step in steps:
        grey = _view(seed, *(float(value) for value in step), *size)
        noisy = grey + noise * random.standard_normal(grey.shape)
        seen.append(np.rint(np.clip(noisy, 0, 255)).astype(np.uint8))
    return seen


def centres(steps):
    """Return the true positions, (N, 3)."""
    return np.array([pose(*step)[:3, 3] for step in steps])


def residual(found, true):
    """Return the rms distance after the best similarity, as a share of the true path's length."""
    p, q = found - found.mean(axis=0), true - true.mean(axis=0)
    u, s, vt = np.linalg.svd(q.T @ p / len(p))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ sign) / (p**2).sum(axis=1).mean()
    away = scale * p @ (u @ sign @ vt).T - q
    length = np.linalg.norm(np.diff(true, axis=0), axis=1).sum()
    return np.sqrt((away**2).sum(axis=1).mean()) / length
