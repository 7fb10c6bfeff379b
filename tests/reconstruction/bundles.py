"""Tracks of a cloud of points, with exact truth."""

import cv2
import numpy as np

import tisfm
from tisfm.reconstruction.calibration.track_bundle import TrackBundle

FOCAL = 200.0


def bundle(zoom, lens=(0.0, 0.0, 0.0, 0.0), noise=0.1, seed=0):
    """Tracks of 8 frames of a cloud of points, with the true poses and points moved a little."""
    random = np.random.default_rng(seed)
    points = random.uniform((-3, -2, 3), (3, 2, 9), (150, 3))
    poses = np.array(
        [np.linalg.inv(tisfm.rigid.pose_matrix([0.2 * k, 0.02 * k, 0, 0, 0.02 * k, 0]))
         for k in range(len(zoom))]
    )[:, :3]  # fmt: skip
    views, indices = (grid.ravel() for grid in np.mgrid[: len(zoom), : len(points)])
    local = np.einsum("nkl,nl->nk", poses[views, :, :3], points[indices]) + poses[views, :, 3]
    straight = local[:, :2] / local[:, 2:]
    distorted = cv2.projectPoints(
        np.column_stack([straight, np.ones(len(straight))]), np.zeros(3), np.zeros(3), np.eye(3),
        np.array(lens),
    )[0][:, 0]  # fmt: skip
    positions = FOCAL * np.exp(np.asarray(zoom)[views])[:, None] * distorted
    return TrackBundle(
        frames=tuple(range(len(zoom))),
        tracks=np.arange(len(points)),
        poses=poses,
        points=points + random.normal(0, 0.01, points.shape),
        views=views,
        indices=indices,
        positions=positions + random.normal(0, noise, positions.shape),
    )
