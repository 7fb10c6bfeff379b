"""Residuals of tracks and their derivatives by poses, points and a camera with lens and zoom."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.calibration.track_bundle import TrackBundle

MAD_TO_DEVIATION = 1.4826  # standard deviation of a normal distribution over its median distance
# the unknowns that all frames share: logarithm of the focal length, and OpenCV's coefficients
COMMON = ("focal", "k1", "k2", "p1", "p2")


@dataclass(frozen=True, kw_only=True, eq=False)
class BundleState:
    """Values of all unknowns."""

    poses: np.ndarray  # (F, 3, 4) float64: world to camera
    points: np.ndarray  # (P, 3) float64: in the world
    common: np.ndarray  # (5,) float64: logarithm of the focal length in px, k1, k2, p1, p2
    zoom: np.ndarray  # (F,) float64: logarithm of the zoom of each frame
    removed_zoom: np.ndarray  # (F,): as for `adjust_camera`

    def moved(self, step: np.ndarray, point_step: np.ndarray) -> "BundleState":
        """Return the state after a step of the camera's side and of the points."""
        count = len(self.poses)
        motion = step[: 6 * count].reshape(count, 6)
        poses = Rotation.from_rotvec(motion[:, 3:]).as_matrix() @ self.poses
        poses[:, :, 3] += motion[:, :3]
        return replace(
            self,
            poses=poses,
            points=self.points + point_step.reshape(-1, 3),
            common=self.common + step[7 * count :],
            zoom=self.zoom + step[6 * count : 7 * count],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class BundleResiduals:
    """Residuals and their derivatives."""

    residuals: np.ndarray  # (M, 2): px
    # by the camera's side: (t, ω) of every frame, the zooms of all frames, the common unknowns
    by_camera: csr_matrix
    by_points: csr_matrix

    @property
    def deviation(self) -> float:
        """Robust standard deviation of a coordinate, px."""
        return MAD_TO_DEVIATION * float(np.median(np.abs(self.residuals)))

    @property
    def weighting_deviation(self) -> float:
        """The deviation that weighs residuals against priors, px."""
        return max(self.deviation, CALIBRATION.min_bundle_deviation)


def linearise(bundle: TrackBundle, state: BundleState) -> BundleResiduals:
    """Return residuals and their derivatives.

    Brown's lens displaces normalised positions, and the focal length of the frame scales them.
    """
    count, rows, views = len(bundle.frames), len(bundle.views), bundle.views
    rotation, shift = state.poses[views, :, :3], state.poses[views, :, 3]
    local = np.einsum("nkl,nl->nk", rotation, state.points[bundle.indices]) + shift
    smallest = CALIBRATION.min_bundle_depth
    depth = np.where(np.abs(local[:, 2]) < smallest, smallest, local[:, 2])
    x, y = local[:, 0] / depth, local[:, 1] / depth
    _, k1, k2, p1, p2 = state.common
    square = x * x + y * y
    factor, slope = 1 + k1 * square + k2 * square**2, 2 * k1 + 4 * k2 * square
    lens = np.stack(
        [
            x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * factor + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )
    by_lens = np.empty((rows, 2, 2))
    by_lens[:, 0, 0] = factor + slope * x * x + 2 * p1 * y + 6 * p2 * x
    by_lens[:, 0, 1] = by_lens[:, 1, 0] = slope * x * y + 2 * p1 * x + 2 * p2 * y
    by_lens[:, 1, 1] = factor + slope * y * y + 6 * p1 * y + 2 * p2 * x
    by_local = np.zeros((rows, 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = 1 / depth
    by_local[:, 0, 2], by_local[:, 1, 2] = -x / depth, -y / depth
    focal = np.exp(state.common[0] + state.zoom[views])[:, None]
    by_local = focal[..., None] * by_lens @ by_local
    by_turn = np.cross(local[:, None, :], by_local)
    projected = lens * focal
    straight = focal * np.stack([x, y], axis=1)
    by_common = [
        projected,
        straight * square[:, None],
        straight * square[:, None] ** 2,
        focal * np.stack([2 * x * y, square + 2 * y * y], axis=1),
        focal * np.stack([square + 2 * x * x, 2 * x * y], axis=1),
    ]
    by_camera = np.concatenate(
        [by_local, by_turn, projected[..., None], np.stack(by_common, axis=2)], axis=2
    )
    columns = np.column_stack(
        [
            6 * views[:, None] + np.arange(6),
            6 * count + views,
            np.tile(7 * count + np.arange(len(COMMON)), (rows, 1)),
        ]
    )
    point_columns = 3 * bundle.indices[:, None] + np.arange(3)
    return BundleResiduals(
        residuals=projected - bundle.positions,
        by_camera=_sparse(by_camera, columns, 7 * count + len(COMMON)),
        by_points=_sparse(by_local @ rotation, point_columns, 3 * len(state.points)),
    )


def _sparse(values: np.ndarray, columns: np.ndarray, width: int) -> csr_matrix:
    """Return a matrix of two rows for each observation: values (M, 2, K) in columns (M, K)."""
    rows, _, size = values.shape
    indices, begins = np.repeat(columns, 2, axis=0), np.arange(0, 2 * rows * size + 1, size)
    return csr_matrix((values.ravel(), indices.ravel(), begins), shape=(2 * rows, width))
