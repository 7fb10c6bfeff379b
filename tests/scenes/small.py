"""A small scene, its rays, and rigid motions by brute force."""

import math

import numpy as np

from tisfm.camera import Camera
from tisfm.scenes import Box, Plane, Scene, Texture

PAINT = Texture(wavelength=0.1)
TURNING = (0.05, -0.03, 0.12, 0.01, -0.02, 0.015)


def twist_matrix(motion):
    T, omega = np.array(motion[:3]), np.array(motion[3:])
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = np.cross(np.eye(3), -omega).T
    matrix[:3, 3] = T
    np.testing.assert_allclose(matrix[:3, :3] @ T, np.cross(omega, T), atol=1e-12)
    return matrix


def series_exponential(motion):
    """exp of the 4×4 twist by its power series, at a 1024th and squared ten times."""
    small = twist_matrix(motion) / 1024
    total, term = np.eye(4), np.eye(4)
    for n in range(1, 12):
        term = term @ small / n
        total = total + term
    for _ in range(10):
        total = total @ total
    return total[:3, :3], total[:3, 3]


def rays_of(pair):
    height, width = pair.depth.shape
    cx, cy = pair.camera.center_for(height, width)
    y, x = np.mgrid[:height, :width]
    return (x - cx) / pair.camera.focal, (y - cy) / pair.camera.focal


def small_scene(motion=TURNING, height=33, width=45, **changes):
    c, s = math.cos(0.5), math.sin(0.5)
    objects = [
        Plane(texture=PAINT, motion=motion),
        Plane(texture=PAINT, point=(0, 1.5, 0), normal=(0.1, -2, -0.3), motion=motion),
        Box(
            texture=PAINT,
            center=(-0.4, 0.5, 4),
            size=(1, 1.2, 0.8),
            axes=[[c, 0, s], [0, 1, 0], [-s, 0, c]],
            motion=tuple(0.7 * value for value in motion),
        ),
    ]
    camera = Camera(focal=40.0, center=(20.3, 17.1))
    return Scene(objects=objects, camera=camera, height=height, width=width, **changes)
