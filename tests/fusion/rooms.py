"""Views of the rendered room, from poses that are known exactly."""

from dataclasses import replace

import numpy as np

import tisfm
from tisfm.fusion import DepthView
from tisfm.rigid import pose_matrix
from tisfm.scenes import Plane, Scene
from tisfm.scenes.room import _furniture, _walls


def room_view(pose, height, width):
    """Return the depth, (H, W) float32, and the frame of the room from a pose, camera to world."""
    to_camera = np.linalg.inv(pose)
    rotation, translation = to_camera[:3, :3], to_camera[:3, 3]
    objects = []
    for item in [*_walls(np.zeros(6), width, 0), *_furniture(np.zeros(6), width, 0)]:
        if isinstance(item, Plane):
            moved = {"point": item.point, "normal": rotation @ item.normal}
        else:
            moved = {"center": item.center, "axes": rotation @ item.axes}
        place = next(iter(moved))
        moved[place] = rotation @ moved[place] + translation
        objects.append(replace(item, **moved))
    camera = tisfm.Camera(0.6 * width)
    scene = Scene(objects=objects, camera=camera, height=height, width=width)
    pair = scene.render(samples=1)
    return pair.depth.astype(np.float32), pair.frame0, camera


def poses_in_room(count):
    """Return poses along a loop of half a metre, looking around by some degrees."""
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return [
        pose_matrix(
            (
                0.5 * np.sin(turn),
                0.15 * np.sin(2 * turn),
                0.4 * (1 - np.cos(turn)),
                0.05 * np.sin(3 * turn),
                0.3 * np.sin(turn),
                0.03 * np.cos(turn),
            )
        )
        for turn in turns
    ]


def noisy_views(rendered, *, noise=0.01, outliers=0.0, seed=0):
    """Return views of depth with noise, relative, and outliers, a share of the pixels.

    Outliers have any inverse depth from 0.3 to 3 times the true one, and no larger a deviation.
    """
    random = np.random.default_rng(seed)
    views = []
    for pose, (depth, frame, camera) in rendered:
        inverse_depth = (1 + noise * random.normal(size=depth.shape)) / depth
        wrong = random.uniform(size=depth.shape) < outliers
        factor = random.uniform(0.3, 3, size=depth.shape)
        inverse_depth = np.where(wrong, factor / depth, inverse_depth).astype(np.float32)
        std = np.float32(max(noise, 1e-4)) * inverse_depth
        views.append(
            DepthView(
                inverse_depth=inverse_depth,
                inverse_depth_std=std,
                pose=pose,
                frame=frame,
                camera=camera,
            )
        )
    return views


def relative_error(points, rendered):
    """Return how far points lie from the true surface, relative to their depth, (N,).

    The mean over the views that do not hide them, of |z/Z − 1|; infinite where all do. Near edges
    the nearest of four pixels counts.
    """
    total, count = np.zeros(len(points)), np.zeros(len(points))
    for pose, (depth, _, camera) in rendered:
        height, width = depth.shape
        cx, cy = camera.center_for(height, width)
        x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
        u, v = (camera.focal * a / np.where(z > 0.05, z, 1) + c for a, c in ((x, cx), (y, cy)))
        inside = (z > 0.05) & (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
        on = np.flatnonzero(inside)
        column, row = np.minimum(u[on].astype(int), width - 2), v[on].astype(int)
        row = np.minimum(row, height - 2)
        four = np.stack([1 / depth[row + j, column + i] for j in (0, 1) for i in (0, 1)])
        across, down = u[on] - column, v[on] - row
        upper, lower = (four[k] + across * (four[k + 1] - four[k]) for k in (0, 2))
        smooth = four.max(axis=0) < 1.05 * four.min(axis=0)
        each = z[on] * four - 1
        nearest = np.take_along_axis(each, np.abs(each).argmin(axis=0)[None], axis=0)[0]
        error = np.where(smooth, z[on] * (upper + down * (lower - upper)) - 1, nearest)
        shown = error < 0.05
        total[on[shown]] += np.abs(error[shown])
        count[on[shown]] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.inf)


def completeness(points, rendered, *, within=0.02):
    """Return the share of pixels, every fourth, with a point near what they see.

    Parameters
    ----------
    within : float
        How near, relative to the depth.
    """
    from scipy.spatial import cKDTree

    tree, found = cKDTree(points), []
    for pose, (depth, _, camera) in rendered:
        cx, cy = camera.center_for(*depth.shape)
        row, column = (a.ravel() for a in np.mgrid[: depth.shape[0] : 4, : depth.shape[1] : 4])
        z = depth[row, column].astype(float)
        ahead = np.stack([(column - cx) / camera.focal, (row - cy) / camera.focal, np.ones(z.size)])
        at = (ahead * z).T @ pose[:3, :3].T + pose[:3, 3]
        found.append(tree.query(at)[0] <= within * z)
    return np.mean(found)
