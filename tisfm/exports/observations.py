"""The frames of a piece, observations of points in them, and the triangulation of these points."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from tisfm.checks import Floats
from tisfm.exports.guided_matching import PosedCamera
from tisfm.exports.model_folder import read_checked_picture
from tisfm.reconstruction.result.folder import depth_path
from tisfm.reconstruction.result.reconstruction import Reconstruction

MIN_OBSERVATIONS = 3  # frames that observe a point; 2 in a piece of two frames; set by hand
CACHED_FRAMES = 24  # frames that stay in memory; set by hand


@dataclass(frozen=True, kw_only=True)
class ObservedPoints:
    """Points, and their observations in M frames."""

    frames: list[int]  # numbers of the M frames
    # (N, M, 2) float64: (x, y), px from the centre of the upper left pixel; NaN for no observation
    image_points: Floats
    positions: Floats  # (N, 3) float64: in the world
    # (N, M) float64: distance from the projected point, px; NaN for no observation
    residual: Floats
    colors: np.ndarray  # (N, 3) uint8


class PieceFrames:
    """The frames of a piece; some pictures stay in memory."""

    def __init__(self, result: Reconstruction, piece: int) -> None:
        self.result = result
        # frame numbers, ascending
        self.numbers: list[int] = np.flatnonzero(result.piece == piece).tolist()
        self.keyframes = [k for k in result.keyframes if result.piece[k] == piece]
        # least number of frames that observe a point
        self.min_observations = min(MIN_OBSERVATIONS, max(2, len(self.numbers)))
        self.grey = lru_cache(CACHED_FRAMES)(self._read_grey)
        self.usable_pixels = lru_cache(CACHED_FRAMES)(self._read_usable_pixels)

    def has_depth(self, frame: int) -> bool:
        """Return whether a frame has depth."""
        return depth_path(self.result.folder, frame).exists()

    def pose(self, frame: int) -> PosedCamera:
        """Return camera and pose of a frame."""
        return PosedCamera(camera=self.result.camera, matrix=self.result.poses[frame])

    def colors(self, frame: int, image_points: np.ndarray) -> np.ndarray:
        """Return the colours of the nearest pixels of a frame, (N, 3) uint8."""
        column, row = np.rint(image_points).astype(np.intp).T
        colors = read_checked_picture(self.result, frame)[row, column]
        return np.repeat(colors[:, None], 3, axis=1) if colors.ndim == 1 else colors

    def _read_grey(self, frame: int) -> np.ndarray:
        picture = read_checked_picture(self.result, frame)
        if picture.ndim == 2:
            return picture
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))

    def _read_usable_pixels(self, frame: int) -> np.ndarray:
        """Return the pixels of the static scene that are not masked, (H, W) bool."""
        usable_pixels = self.result.labels(frame) == 0
        has_std = np.isfinite(self.result.inverse_depth_std(frame))
        if has_std.any():
            usable_pixels &= has_std
        return np.asarray(usable_pixels)


# Set by hand.
GAUSS_NEWTON_ITERATIONS = 8  # for each point
NOISE = 0.5  # px: standard deviation of a measured position; the threshold of Huber's weights
MAX_RESIDUAL = 1.5  # px, in frames up to 640 px: observations with larger residuals are dropped
# The standard deviation of the initial depth restrains a point if its rays are parallel.
MIN_RELATIVE_STD = 0.05  # standard deviation, as a share of the depth
STD_FACTOR = 2.0  # factor of the standard deviation in the depth map
MAX_BATCH_OBSERVATIONS = 2**17  # observations that are processed together
MIN_DEPTH = 1e-3  # bound of Z in a camera, as a share of the initial depth


@dataclass(frozen=True, kw_only=True)
class TriangulatedPoints:
    """Points and the residuals of their observations."""

    positions: Floats  # (N, 3) float64
    # (N, M) float64: distance between measured and projected position, px; NaN for no observation
    residual: Floats


def triangulate(
    # (N, M, 2) float64: (x, y), px; NaN for no observation. Frame 0 has the initial depth of the
    # points.
    image_points: np.ndarray,
    poses: list[PosedCamera],  # poses of the M frames
    shape: tuple[int, int],  # height and width of the frames, px
    initial: np.ndarray,  # (N, 3) float64: points by the depth of frame 0
    relative_std: np.ndarray,  # (N,) float64: standard deviation of that depth, as a share of it
) -> TriangulatedPoints:
    """Return the points of least weighted squared residuals in M frames."""
    matrices = np.array([pose.matrix for pose in poses])
    focal = np.array([pose.camera.focal for pose in poses])
    centers = np.array([pose.camera.center_for(*shape) for pose in poses])
    is_observed = np.isfinite(image_points[..., 0])
    points = initial.copy()
    axis = matrices[0, :3, 2]
    depth = (initial - matrices[0, :3, 3]) @ axis
    std = np.maximum(STD_FACTOR * relative_std, MIN_RELATIVE_STD) * depth
    for _ in range(GAUSS_NEWTON_ITERATIONS):
        residual, jacobian = _linearise(points, image_points, matrices, focal, centers, depth)
        distance = np.hypot(residual[..., 0], residual[..., 1])
        # Huber's weight divided by the variance
        weight = np.where(is_observed, 1 / np.maximum(distance, NOISE) / NOISE, 0)
        matrix = np.einsum("nm,nmki,nmkj->nij", weight, jacobian, jacobian, optimize=True)
        vector = np.einsum("nm,nmki,nmk->ni", weight, jacobian, residual, optimize=True)
        matrix += np.einsum("n,i,j->nij", std**-2, axis, axis)
        depth_residual = (points - matrices[0, :3, 3]) @ axis - depth
        vector += (depth_residual / std**2)[:, None] * axis
        matrix += np.eye(3) * (1e-9 * np.trace(matrix, axis1=1, axis2=2))[:, None, None]
        points = points - np.linalg.solve(matrix, vector[..., None])[..., 0]
    residual, _ = _linearise(points, image_points, matrices, focal, centers, depth)
    distance = np.hypot(residual[..., 0], residual[..., 1])
    local_z = np.einsum("nmi,mi->nm", points[:, None] - matrices[:, :3, 3], matrices[:, :3, 2])
    distance = np.where(local_z > MIN_DEPTH * depth[:, None], distance, np.inf)
    return TriangulatedPoints(positions=points, residual=np.where(is_observed, distance, np.nan))


def consistent_points(
    # image_points, poses, shape, initial, relative_std: as for `triangulate`
    image_points: np.ndarray,
    poses: list[PosedCamera],
    shape: tuple[int, int],
    initial: np.ndarray,
    relative_std: np.ndarray,
    min_observations: int,  # least number of frames that observe a point, frame 0 among them
) -> tuple[np.ndarray, np.ndarray, TriangulatedPoints]:
    """Drop observations that do not fit their point, and points with too few observations.

    Returns which points are kept, (N,) bool; the observations of the K kept points, (K, M, 2)
    float64, NaN for dropped observations; and the kept points.
    """
    batch = max(1, MAX_BATCH_OBSERVATIONS // len(poses))
    parts = [
        _consistent_batch(
            image_points[k : k + batch], poses, shape, initial[k : k + batch], std, min_observations
        )
        for k in range(0, max(1, len(image_points)), batch)
        for std in [relative_std[k : k + batch]]
    ]
    is_kept, observations, positions, residual = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    return is_kept, observations, TriangulatedPoints(positions=positions, residual=residual)


def _consistent_batch(
    image_points: np.ndarray,
    poses: list[PosedCamera],
    shape: tuple[int, int],
    initial: np.ndarray,
    relative_std: np.ndarray,
    min_observations: int,
) -> tuple[np.ndarray, ...]:
    """Do the work of `consistent_points` for one batch."""
    limit = MAX_RESIDUAL * max(1.0, max(shape) / 640)
    image_points, index = image_points.copy(), np.arange(len(image_points))
    threshold = 4 * limit
    while True:
        has_enough = np.isfinite(image_points[..., 0]).sum(axis=1) >= min_observations
        has_enough &= np.isfinite(image_points[:, 0, 0])
        image_points, index = image_points[has_enough], index[has_enough]
        points = triangulate(image_points, poses, shape, initial[index], relative_std[index])
        with np.errstate(invalid="ignore"):
            is_outlier = points.residual > threshold
        if threshold <= limit and not is_outlier.any():
            break
        image_points[is_outlier] = np.nan
        threshold = max(threshold / 2, limit)
    is_kept = np.zeros(len(initial), bool)
    is_kept[index] = True
    return is_kept, image_points, points.positions, points.residual


def _linearise(
    points: np.ndarray,
    image_points: np.ndarray,
    matrices: np.ndarray,
    focal: np.ndarray,
    centers: np.ndarray,
    depth: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals (N, M, 2), 0 for no observation, and derivatives (N, M, 2, 3)."""
    rotations = matrices[:, :3, :3]
    local = np.einsum("nmi,mij->nmj", points[:, None] - matrices[:, :3, 3], rotations)
    z = np.maximum(local[..., 2], MIN_DEPTH * depth[:, None])
    normal = local[..., :2] / z[..., None]
    residual = normal * focal[:, None] + centers - image_points
    residual = np.where(np.isfinite(residual), residual, 0)
    world_to_camera = rotations.transpose(0, 2, 1)  # rows: axes of the camera in the world
    jacobian = world_to_camera[None, :, :2] - normal[..., None] * world_to_camera[None, :, None, 2]
    return residual, jacobian * (focal / z)[..., None, None]
