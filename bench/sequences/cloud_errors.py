"""Errors of fused points: how many lie on the true surface, and how much of it they cover."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tisfm.camera import Camera
from tisfm.metrics import Similarity

TOLERANCES = (0.02, 0.05)  # shares of the true depth
STEP = 8  # px between the true points of a frame, along rows and columns
MAX_POINTS = 100_000  # points of a cloud whose distance is measured, evenly from all points
NEAREST_Z = 1e-6  # of the depth: points with a smaller Z are behind the camera

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueFrame:
    """A frame with its true depth."""

    depth: NDArray[np.float32]  # (H, W): true depth Z, m; NaN where unknown
    pose: Floats  # (4, 4): camera to world
    camera: Camera  # without distortion

    def project(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return column, row and depth Z of points in the world, (M, 3)."""
        x, y, z = ((points - self.pose[:3, 3]) @ self.pose[:3, :3]).T
        safe_z = np.where(z > NEAREST_Z, z, 1.0)
        cx, cy = self.camera.center_for(*self.depth.shape)
        focal = self.camera.focal
        return focal * x / safe_z + cx, focal * y / safe_z + cy, z

    def surface(self, depth: NDArray, step: int = STEP) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Return points of the world at some depth Z of the pixels, (M, 3), that depth, and pixels.

        The pixels, every `step`-th of rows and columns, are indices of the flat image. Pixels
        without depth are left out.
        """
        rows, columns = (
            a.ravel() for a in np.mgrid[: depth.shape[0] : step, : depth.shape[1] : step]
        )
        z = depth[rows, columns].astype(float)
        is_known = np.isfinite(z) & (z > 0)
        rows, columns, z = rows[is_known], columns[is_known], z[is_known]
        cx, cy = self.camera.center_for(*depth.shape)
        rays = np.stack([(columns - cx) / self.camera.focal, (rows - cy) / self.camera.focal])
        rays = np.vstack([rays, np.ones(len(z))])
        points = (rays * z).T @ self.pose[:3, :3].T + self.pose[:3, 3]
        return points, z, rows * depth.shape[1] + columns


@dataclass(frozen=True, kw_only=True)
class CloudErrors:
    """Shares in %, one for each of `TOLERANCES`."""

    accuracy: tuple[float, ...]  # of the points of the cloud on the true surface
    completeness: tuple[float, ...]  # of the true points near a point of the cloud
    points: int  # number of points of the cloud


def cloud_errors(points: NDArray, truth: Sequence[TrueFrame], max_depth: float) -> CloudErrors:
    """Compare points in the world, (M, 3), with the true surface up to a depth, m."""
    points = np.asarray(points, float)
    if not len(points):
        nothing = (0.0,) * len(TOLERANCES)
        return CloudErrors(accuracy=nothing, completeness=nothing, points=0)
    measured_points = points[:: -(-len(points) // MAX_POINTS)]
    distance, nearest_z = distance_from_surface(measured_points, truth)
    distance = distance[nearest_z <= max_depth]
    gaps = gaps_of_surface(points, truth, max_depth)
    return CloudErrors(
        accuracy=tuple(_share(distance, tolerance) for tolerance in TOLERANCES),
        completeness=tuple(_share(gaps, tolerance) for tolerance in TOLERANCES),
        points=len(points),
    )


def distance_from_surface(points: Floats, truth: Sequence[TrueFrame]) -> tuple[Floats, Floats]:
    """Return the distance of points from the true surface, and their smallest Z in any frame.

    In every frame that shows the point, the distance is |z/Z − 1|: z is its depth and Z the true
    depth where it projects, of the four pixels around the one that fits best. The smallest distance
    of all frames counts, as a point on the surface fits the frames that see it, and an occluded
    frame shows another surface. It is infinite if no frame with a true depth shows the point.
    """
    distance, nearest_z = np.full(len(points), np.inf), np.full(len(points), np.inf)
    for frame in truth:
        u, v, z = frame.project(points)
        height, width = frame.depth.shape
        is_inside = (z > NEAREST_Z) & (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1)
        pixels = np.flatnonzero(is_inside)
        nearest_z[pixels] = np.minimum(nearest_z[pixels], z[pixels])
        column, row = u[pixels].astype(np.intp), v[pixels].astype(np.intp)
        for j, i in np.ndindex(2, 2):
            error = np.abs(z[pixels] / frame.depth[row + j, column + i] - 1)
            distance[pixels] = np.fmin(distance[pixels], error)
    return distance, nearest_z


def gaps_of_surface(points: Floats, truth: Sequence[TrueFrame], max_depth: float) -> Floats:
    """Return the distance of true points from the nearest point of a cloud, as a share of Z.

    Every `STEP`-th pixel of all frames gives a true point, up to the depth `max_depth`.
    """
    tree, gaps = cKDTree(points), []
    for frame in truth:
        depth = np.where(frame.depth <= max_depth, frame.depth, np.float32(np.nan))
        true_points, z, _ = frame.surface(depth)
        # Farther points miss every tolerance.
        found, _ = tree.query(true_points, distance_upper_bound=max(TOLERANCES) * max_depth)
        gaps.append(found / z)
    return np.concatenate(gaps)


def align_surfaces(
    depths: Sequence[NDArray], poses: Floats, truth: Sequence[TrueFrame]
) -> Similarity:
    """Return the similarity from the world of a reconstruction to the true world.

    `depths` and `poses` are of the frames of `truth`. The rotation is the mean of those between
    true and found cameras. The scale is the median ratio of true and found depth, the translation
    the median that takes found surfaces to true ones. Then errors of the path count as far as they
    deform the surfaces.
    """
    turns = [frame.pose[:3, :3] @ pose[:3, :3].T for frame, pose in zip(truth, poses, strict=True)]
    left, _, right = np.linalg.svd(np.sum(turns, axis=0))
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    found, true, ratios = [], [], []
    for depth, pose, frame in zip(depths, poses, truth, strict=True):
        is_known = np.isfinite(depth) & (depth > 0) & np.isfinite(frame.depth)
        true_points, true_z, _ = frame.surface(np.where(is_known, frame.depth, np.nan))
        own = TrueFrame(depth=frame.depth, pose=pose, camera=frame.camera)
        points, z, _ = own.surface(np.where(is_known, depth, np.nan))
        found.append(points)
        true.append(true_points)
        ratios.append(true_z / z)
    scale = float(np.median(np.concatenate(ratios)))
    moved = scale * np.concatenate(found) @ rotation.T
    translation = np.median(np.concatenate(true) - moved, axis=0)
    return Similarity(rotation=rotation, translation=translation, scale=scale)


def _share(distances: Floats, tolerance: float) -> float:
    return 100 * float(np.mean(distances <= tolerance)) if len(distances) else 0.0
