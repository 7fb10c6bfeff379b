"""Adjustment of poses, points and a camera whose focal length may change from frame to frame.

Unknowns of the camera are the logarithm of the focal length, the logarithm of the zoom of each
frame, and coefficients of the lens. Each of them can be free or fixed. The result has their
standard deviations, which include what poses and points take from them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.spatial.transform import Rotation

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import points_of_tracks
from tisfm.reconstruction.tracks.views import choose_long_tracks

# the unknowns that all frames share: logarithm of the focal length, and OpenCV's coefficients
COMMON = ("focal", "k1", "k2", "p1", "p2")
MAD_TO_DEVIATION = 1.4826  # standard deviation of a normal distribution over its median distance


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackBundle:
    """Frames of a piece of a path, points of tracks, and their positions in the frames."""

    frames: tuple[int, ...]  # numbers of the F frames
    tracks: np.ndarray  # (P,) int: numbers of the tracks
    poses: np.ndarray  # (F, 3, 4) float64: world to camera
    points: np.ndarray  # (P, 3) float64: in the world
    views: np.ndarray  # (M,) int: index of the frame of each observation
    indices: np.ndarray  # (M,) int: index of its point
    positions: np.ndarray  # (M, 2) float64: px from the centre

    @classmethod
    def from_piece(
        cls,
        piece: Piece,
        observations: Sequence[Observations],  # by frame
        frames: Sequence[int],  # frames of the piece that are used
        camera: Camera,  # pinhole camera
        shape: tuple[int, int],  # height and width of the frames, px
    ) -> "TrackBundle":
        """Return the longest tracks of frames of a piece."""
        center = np.array(camera.center_for(*shape))
        selected = choose_long_tracks([observations[frame] for frame in frames], max(shape))
        views, tracks, positions, world = [], [], [], []
        for k, in_frame in enumerate(selected):
            rows, points = points_of_tracks(in_frame, piece.points)
            views.append(np.full(len(rows), k))
            tracks.append(in_frame.tracks[rows])
            positions.append(in_frame.points[rows] - center)
            world.append(points)
        numbers, first, indices, counts = np.unique(
            np.concatenate(tracks), return_index=True, return_inverse=True, return_counts=True
        )
        is_used = counts[indices] >= CALIBRATION.min_bundle_frames
        remaining = np.flatnonzero(counts >= CALIBRATION.min_bundle_frames)
        return cls(
            frames=tuple(frames),
            tracks=numbers[remaining],
            poses=np.array([np.linalg.inv(piece.poses[frame])[:3] for frame in frames]),
            points=np.concatenate(world)[first[remaining]],
            views=np.concatenate(views)[is_used],
            indices=np.searchsorted(remaining, indices[is_used]),
            positions=np.concatenate(positions)[is_used],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustedCamera:
    """The camera of an adjustment, with its standard deviations."""

    bundle: TrackBundle  # with adjusted poses and points
    common: np.ndarray  # (5,) float64: log focal length / px, k1, k2, p1, p2
    common_deviation: np.ndarray  # (5,): 0 where fixed
    zoom: np.ndarray  # (F,) float64: logarithm of the zoom of each frame; 0 in the first frame
    zoom_deviation: np.ndarray  # (F,): 0 where fixed
    residual: float  # px: robust standard deviation of a coordinate
    costs: np.ndarray  # (P,) float64: by track, sum of the robust costs of its observations, px²

    @property
    def cost(self) -> float:
        """Sum of the robust costs, px²."""
        return float(self.costs.sum())

    @property
    def focal(self) -> float:
        """Focal length of the first frame, px."""
        return float(np.exp(self.common[0]))


def adjust_camera(
    bundle: TrackBundle,
    focal: float,  # px: start value
    free: Sequence[str] = (),  # the free unknowns of `COMMON`
    *,
    has_zoom: bool = False,  # whether each frame has a focal length of its own
    scales: Sequence[float] = CALIBRATION.bundle_scales,
    steps: int = CALIBRATION.bundle_steps,
) -> AdjustedCamera:
    """Adjust poses, points and the free unknowns of the camera.

    `steps` bounds the steps with each of the `scales` (px) of the robust loss.

    The zoom of the first frame is 0. The change of the zoom from frame to frame hardly changes, as
    far as the tracks allow; single jumps are allowed.

    References
    ----------
    Triggs et al., "Bundle adjustment – a modern synthesis", 2000, doi 10.1007/3-540-44480-7_21.
    """
    count = len(bundle.frames)
    is_free = np.ones(7 * count + len(COMMON), bool)
    is_free[:6] = False  # the pose of the first frame
    is_free[6 * count : 7 * count] = has_zoom
    is_free[6 * count] = False
    is_free[7 * count :] = [name in free for name in COMMON]
    state = _State(
        poses=bundle.poses,
        points=bundle.points,
        common=np.array([np.log(focal), 0.0, 0.0, 0.0, 0.0]),
        zoom=np.zeros(count),
    )
    for scale in scales:
        state = _minimise(bundle, state, is_free, scale, steps)
    residuals, camera_jacobian, point_jacobian, _ = _linearise(bundle, state)
    deviation = MAD_TO_DEVIATION * float(np.median(np.abs(residuals)))
    reduced = _normal_equations(
        bundle, state, residuals, camera_jacobian, point_jacobian, is_free, deviation, scale
    )
    covariance = np.zeros(len(is_free))
    inverse = np.linalg.pinv(reduced.matrix, hermitian=True)
    covariance[is_free] = np.maximum(np.diag(inverse), 0) * CALIBRATION.correlated_observations
    deviations = np.sqrt(covariance)
    return AdjustedCamera(
        bundle=replace(bundle, poses=state.poses, points=state.points),
        common=state.common,
        common_deviation=deviations[7 * count :],
        zoom=state.zoom,
        zoom_deviation=deviations[6 * count : 7 * count],
        residual=deviation,
        costs=np.bincount(
            bundle.indices, _costs(residuals, scale), minlength=len(bundle.points)
        ),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    poses: np.ndarray
    points: np.ndarray
    common: np.ndarray
    zoom: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reduced:
    """Normal equations of the camera's side, after points were eliminated."""

    matrix: np.ndarray
    gradient: np.ndarray
    coupling: csr_matrix  # camera × points
    inverse_points: csr_matrix  # block diagonal
    point_gradient: np.ndarray


def _costs(residuals: np.ndarray, scale: float) -> np.ndarray:
    """Return Cauchy's robust cost of each observation, (M,), px²."""
    square = (residuals**2).sum(axis=1)
    return np.asarray(scale**2 * np.log1p(square / scale**2))


def _linearise(
    bundle: TrackBundle, state: _State
) -> tuple[np.ndarray, csr_matrix, csr_matrix, np.ndarray]:
    """Return residuals, (M, 2) px, and the Jacobians by the camera's side and by points."""
    count, rows = len(bundle.frames), len(bundle.views)
    rotation, shift = state.poses[bundle.views, :, :3], state.poses[bundle.views, :, 3]
    local = np.einsum("nkl,nl->nk", rotation, state.points[bundle.indices]) + shift
    depth = np.where(np.abs(local[:, 2]) < 1e-6, 1e-6, local[:, 2])
    x, y = local[:, 0] / depth, local[:, 1] / depth
    _, k1, k2, p1, p2 = state.common
    square = x * x + y * y
    factor = 1 + k1 * square + k2 * square**2
    slope = 2 * k1 + 4 * k2 * square
    lens_x = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    lens_y = y * factor + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    focal = np.exp(state.common[0] + state.zoom[bundle.views])
    projected = np.stack([lens_x, lens_y], axis=1) * focal[:, None]
    by_lens = np.empty((rows, 2, 2))
    by_lens[:, 0, 0] = factor + slope * x * x + 2 * p1 * y + 6 * p2 * x
    by_lens[:, 0, 1] = slope * x * y + 2 * p1 * x + 2 * p2 * y
    by_lens[:, 1, 0] = slope * x * y + 2 * p1 * x + 2 * p2 * y
    by_lens[:, 1, 1] = factor + slope * y * y + 6 * p1 * y + 2 * p2 * x
    by_local = np.zeros((rows, 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = 1 / depth
    by_local[:, 0, 2], by_local[:, 1, 2] = -x / depth, -y / depth
    by_local = focal[:, None, None] * by_lens @ by_local
    by_turn = np.cross(local[:, None, :], by_local)
    ones = np.ones(rows)
    by_common = np.stack(
        [
            projected,
            focal[:, None] * (square * np.stack([x, y])).T,
            focal[:, None] * (square**2 * np.stack([x, y])).T,
            focal[:, None] * np.stack([2 * x * y, square + 2 * y * y]).T,
            focal[:, None] * np.stack([square + 2 * x * x, 2 * x * y]).T,
        ],
        axis=2,
    )
    values = np.concatenate([by_local, by_turn, projected[:, :, None], by_common], axis=2)
    views = bundle.views
    columns = np.concatenate(
        [
            6 * views[:, None] + np.arange(6),
            (6 * count + views)[:, None],
            7 * count + np.arange(len(COMMON))[None] * np.ones((rows, 1), int),
        ],
        axis=1,
    )
    camera_jacobian = _sparse(values, columns, 7 * count + len(COMMON))
    point_columns = 3 * bundle.indices[:, None] + np.arange(3)
    point_jacobian = _sparse(by_local @ rotation, point_columns, 3 * len(state.points))
    return projected - bundle.positions, camera_jacobian, point_jacobian, ones


def _sparse(values: np.ndarray, columns: np.ndarray, width: int) -> csr_matrix:
    rows, _, size = values.shape
    return csr_matrix(
        (
            values.ravel(),
            np.repeat(columns, 2, axis=0).ravel(),
            np.arange(0, 2 * rows * size + 1, size),
        ),
        shape=(2 * rows, width),
    )


def _normal_equations(
    bundle: TrackBundle,
    state: _State,
    residuals: np.ndarray,
    camera_jacobian: csr_matrix,
    point_jacobian: csr_matrix,
    is_free: np.ndarray,
    deviation: float,
    scale: float,
    damping: float = 0.0,
) -> _Reduced:
    count = len(bundle.frames)
    weight = 1 / (1 + (residuals**2).sum(axis=1) / scale**2) / deviation**2
    weights = diags(np.repeat(weight, 2))
    weighted = camera_jacobian.T @ weights
    matrix = (weighted @ camera_jacobian).toarray()
    gradient = weighted @ residuals.ravel()
    _add_zoom_prior(matrix, gradient, state.zoom, bundle.frames)
    # the scale of the scene: the centre of the farthest camera keeps its distance
    shifts = state.poses[:, :, 3]
    far = int(np.argmax(np.linalg.norm(np.einsum("nkl,nk->nl", state.poses[:, :, :3], shifts), axis=1)))
    along = np.zeros(len(is_free))
    along[6 * far : 6 * far + 3] = shifts[far] / max(np.linalg.norm(shifts[far]), 1e-12)
    matrix += np.outer(along, along) * matrix[6 * far, 6 * far]
    coupling = (weighted @ point_jacobian).tocsr()[is_free]
    point_weighted = point_jacobian.T @ weights
    blocks = _point_blocks(bundle, point_jacobian, weight, len(state.points))
    blocks += damping * blocks * np.eye(3) + 1e-12 * np.trace(blocks, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-30 * np.eye(3)
    inverse = np.linalg.inv(blocks)
    inverse_points = csr_matrix(
        (
            inverse.ravel(),
            np.repeat(np.arange(3 * len(blocks)).reshape(-1, 1, 3), 3, axis=1).ravel(),
            np.arange(0, 9 * len(blocks) + 1, 3),
        ),
        shape=(3 * len(blocks),) * 2,
    )
    point_gradient = point_weighted @ residuals.ravel()
    matrix, gradient = matrix[np.ix_(is_free, is_free)], gradient[is_free]
    matrix += damping * np.diag(np.diag(matrix))
    eliminated = coupling @ inverse_points
    return _Reduced(
        matrix=matrix - (eliminated @ coupling.T).toarray(),
        gradient=gradient - eliminated @ point_gradient,
        coupling=coupling,
        inverse_points=inverse_points,
        point_gradient=point_gradient,
    )


def _point_blocks(
    bundle: TrackBundle, point_jacobian: csr_matrix, weight: np.ndarray, count: int
) -> np.ndarray:
    jacobian = point_jacobian.data.reshape(-1, 2, 3)
    products = np.einsum("n,nki,nkj->nij", weight, jacobian, jacobian)
    blocks = np.zeros((count, 3, 3))
    np.add.at(blocks, bundle.indices, products)
    return blocks


def _add_zoom_prior(
    matrix: np.ndarray, gradient: np.ndarray, zoom: np.ndarray, frames: Sequence[int]
) -> None:
    """Add a prior to normal equations: the zoom per frame hardly changes; jumps weigh less."""
    count = len(frames)
    if count < 3:
        return
    steps = np.diff(np.array(frames, np.float64))
    change = np.zeros((count - 2, count))
    for k in range(count - 2):
        change[k, k : k + 3] = 1 / steps[k], -1 / steps[k] - 1 / steps[k + 1], 1 / steps[k + 1]
    residual = change @ zoom / CALIBRATION.zoom_change
    weight = 1 / (1 + residual**2)
    weighted = change * (weight / CALIBRATION.zoom_change**2)[:, None]
    part = slice(6 * count, 7 * count)
    matrix[part, part] += weighted.T @ change
    gradient[part] += weighted.T @ (change @ zoom)


def _minimise(
    bundle: TrackBundle, state: _State, is_free: np.ndarray, scale: float, steps: int
) -> _State:
    """Return the state after damped Gauss–Newton steps with a robust loss."""
    damping = CALIBRATION.bundle_damping
    residuals, camera_jacobian, point_jacobian, _ = _linearise(bundle, state)
    cost = float(_costs(residuals, scale).sum())
    deviation = 1.0
    for _ in range(steps):
        deviation = max(MAD_TO_DEVIATION * float(np.median(np.abs(residuals))), 0.02)
        reduced = _normal_equations(
            bundle, state, residuals, camera_jacobian, point_jacobian, is_free, deviation, scale, damping
        )
        try:
            step = np.zeros(len(is_free))
            step[is_free] = -np.linalg.solve(reduced.matrix, reduced.gradient)
        except np.linalg.LinAlgError:
            damping *= 10
            continue
        point_step = -reduced.inverse_points @ (
            reduced.point_gradient + reduced.coupling.T @ step[is_free]
        )
        candidate = _moved(state, step, point_step)
        linear = _linearise(bundle, candidate)
        new_cost = float(_costs(linear[0], scale).sum())
        if not new_cost < cost:
            damping *= 10
            if damping > 1e6:
                break
            continue
        is_done = cost - new_cost < CALIBRATION.bundle_tolerance * cost
        state, cost, damping = candidate, new_cost, max(damping / 10, 1e-9)
        residuals, camera_jacobian, point_jacobian, _ = linear
        if is_done:
            break
    return state


def _moved(state: _State, step: np.ndarray, point_step: np.ndarray) -> _State:
    count = len(state.poses)
    motion = step[: 6 * count].reshape(count, 6)
    turn = Rotation.from_rotvec(motion[:, 3:]).as_matrix()
    poses = turn @ state.poses
    poses[:, :, 3] += motion[:, :3]
    return _State(
        poses=poses,
        points=state.points + point_step.reshape(-1, 3),
        common=state.common + step[7 * count :],
        zoom=state.zoom + step[6 * count : 7 * count],
    )
