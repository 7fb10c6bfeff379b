"""Adjustment of poses, points and a camera whose focal length may change from frame to frame.

Unknowns of the camera are the logarithm of the focal length, the logarithm of the zoom of each
frame, and coefficients of the lens. Each of them is free or fixed. The result has their standard
deviations, which include what poses and points take from them. pycolmap's adjustment knows no
prior of a focal length that changes slowly, so the normal equations are solved here.
"""

from collections.abc import Sequence
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
MIN_DEPTH = 1e-6  # smallest depth, in the unit of the poses, that a projection divides by


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackBundle:
    """Frames of a piece of a path, points of tracks, and their positions in the frames."""

    frames: tuple[int, ...]  # numbers of the F frames
    tracks: np.ndarray  # (P,) int: numbers of the tracks
    poses: np.ndarray  # (F, 3, 4) float64: world to camera
    points: np.ndarray  # (P, 3) float64: in the world
    views: np.ndarray  # (M,) int: index of the frame of each observation
    indices: np.ndarray  # (M,) int: index of its point
    positions: np.ndarray  # (M, 2) float64: px from the principal point

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
    common: np.ndarray  # (5,) float64: logarithm of the focal length in px, k1, k2, p1, p2
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
    free: Sequence[str] = (),  # the free unknowns of `COMMON`; the others keep their start value
    *,
    radial: float = 0.0,  # start value of k1
    has_zoom: bool = False,  # whether each frame has a focal length of its own
    # (F,): zoom that was removed from the tracks before; the prior holds for the sum
    removed_zoom: np.ndarray | None = None,
    # px: residuals beyond these have a decreasing weight; adjustments follow one another
    scales: Sequence[float] = CALIBRATION.bundle_scales,
    steps: int = CALIBRATION.bundle_steps,  # largest number of steps of each adjustment
) -> AdjustedCamera:
    """Adjust poses, points and the free unknowns of the camera.

    The zoom of the first frame is 0. A prior says that the zoom per frame hardly changes from frame
    to frame; single jumps are allowed. Other coefficients of the lens start at 0.

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
        common=np.array([np.log(focal), radial, 0.0, 0.0, 0.0]),
        zoom=np.zeros(count),
        removed_zoom=np.zeros(count) if removed_zoom is None else removed_zoom,
    )
    for scale in scales:
        state = _minimise(bundle, state, is_free, scale, steps)
    linear = _linearise(bundle, state)
    variances = np.zeros(len(is_free))
    matrix = _reduce(bundle, state, linear, is_free, scales[-1]).matrix
    variances[is_free] = _find_variances(matrix) * CALIBRATION.correlated_observations
    deviations = np.sqrt(variances)
    costs = _costs(linear.residuals, scales[-1])
    return AdjustedCamera(
        bundle=replace(bundle, poses=state.poses, points=state.points),
        common=state.common,
        common_deviation=deviations[7 * count :],
        zoom=state.zoom,
        zoom_deviation=deviations[6 * count : 7 * count],
        residual=linear.deviation,
        costs=np.bincount(bundle.indices, costs, minlength=len(bundle.points)),
    )


def _find_variances(matrix: np.ndarray) -> np.ndarray:
    """Return the diagonal of the inverse of normal equations; infinite if there is no inverse."""
    if not np.isfinite(matrix).all():
        return np.full(len(matrix), np.inf)
    return np.maximum(np.diag(np.linalg.pinv(matrix, hermitian=True)), 0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    """Values of all unknowns."""

    poses: np.ndarray
    points: np.ndarray
    common: np.ndarray
    zoom: np.ndarray
    removed_zoom: np.ndarray  # as for `adjust_camera`

    def moved(self, step: np.ndarray, point_step: np.ndarray) -> "_State":
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
class _Linear:
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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reduced:
    """Normal equations of the camera's side, after the points were eliminated."""

    matrix: np.ndarray
    gradient: np.ndarray
    coupling: csr_matrix  # camera's side × points
    inverse_points: csr_matrix  # block diagonal
    point_gradient: np.ndarray

    def point_step(self, step: np.ndarray) -> np.ndarray:
        """Return the step of the points that belongs to a step of the camera's side."""
        return np.asarray(-self.inverse_points @ (self.point_gradient + self.coupling.T @ step))


def _costs(residuals: np.ndarray, scale: float) -> np.ndarray:
    """Return Cauchy's robust cost of each observation, (M,), px²."""
    square = (residuals**2).sum(axis=1)
    return np.asarray(scale**2 * np.log1p(square / scale**2))


def _linearise(bundle: TrackBundle, state: _State) -> _Linear:
    """Return residuals and their derivatives.

    Brown's lens displaces normalised positions, and the focal length of the frame scales them.
    """
    count, rows, views = len(bundle.frames), len(bundle.views), bundle.views
    rotation, shift = state.poses[views, :, :3], state.poses[views, :, 3]
    local = np.einsum("nkl,nl->nk", rotation, state.points[bundle.indices]) + shift
    depth = np.where(np.abs(local[:, 2]) < MIN_DEPTH, MIN_DEPTH, local[:, 2])
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
    return _Linear(
        residuals=projected - bundle.positions,
        by_camera=_sparse(by_camera, columns, 7 * count + len(COMMON)),
        by_points=_sparse(by_local @ rotation, point_columns, 3 * len(state.points)),
    )


def _sparse(values: np.ndarray, columns: np.ndarray, width: int) -> csr_matrix:
    """Return a matrix of two rows for each observation: values (M, 2, K) in columns (M, K)."""
    rows, _, size = values.shape
    indices, begins = np.repeat(columns, 2, axis=0), np.arange(0, 2 * rows * size + 1, size)
    return csr_matrix((values.ravel(), indices.ravel(), begins), shape=(2 * rows, width))


def _reduce(
    bundle: TrackBundle,
    state: _State,
    linear: _Linear,
    is_free: np.ndarray,  # (K,) bool: the free unknowns of the camera's side
    scale: float,
    damping: float = 0.0,
) -> _Reduced:
    """Return the normal equations of the camera's side, in units of the residuals' deviation."""
    weight = 1 / (1 + (linear.residuals**2).sum(axis=1) / scale**2) / linear.weighting_deviation**2
    weighted = linear.by_camera.T @ diags(np.repeat(weight, 2))
    matrix = (weighted @ linear.by_camera).toarray()
    gradient = weighted @ linear.residuals.ravel()
    _add_zoom_prior(matrix, gradient, state.zoom + state.removed_zoom, bundle.frames)
    _fix_scale(matrix, state.poses)
    coupling = (weighted @ linear.by_points).tocsr()[is_free]
    matrix, gradient = matrix[np.ix_(is_free, is_free)], gradient[is_free]
    matrix += damping * np.diag(np.diag(matrix))
    inverse_points = _inverse_point_blocks(bundle, linear, weight, damping)
    point_gradient = linear.by_points.T @ (np.repeat(weight, 2) * linear.residuals.ravel())
    eliminated = coupling @ inverse_points
    return _Reduced(
        matrix=matrix - (eliminated @ coupling.T).toarray(),
        gradient=gradient - eliminated @ point_gradient,
        coupling=coupling,
        inverse_points=inverse_points,
        point_gradient=point_gradient,
    )


def _inverse_point_blocks(
    bundle: TrackBundle, linear: _Linear, weight: np.ndarray, damping: float
) -> csr_matrix:
    """Return the inverse of the points' part of normal equations, block diagonal."""
    jacobian, count = linear.by_points.data.reshape(-1, 2, 3), len(bundle.points)
    blocks = np.zeros((count, 3, 3))
    np.add.at(blocks, bundle.indices, np.einsum("n,nki,nkj->nij", weight, jacobian, jacobian))
    trace = np.trace(blocks, axis1=1, axis2=2)[:, None, None]
    # a little on the diagonal keeps points without parallax regular
    inverse = np.linalg.inv(
        blocks + (damping * blocks + CALIBRATION.min_point_stiffness * (trace + 1e-30)) * np.eye(3)
    )
    indices = np.repeat(np.arange(3 * count).reshape(-1, 1, 3), 3, axis=1)
    return csr_matrix(
        (inverse.ravel(), indices.ravel(), np.arange(0, 9 * count + 1, 3)), shape=(3 * count,) * 2
    )


def _fix_scale(matrix: np.ndarray, poses: np.ndarray) -> None:
    """Add a term that keeps the scale: the distance of the farthest camera from the first one."""
    # positions of the first camera, in the coordinates of every frame
    first = poses[:, :, 3] - poses[:, :, :3] @ poses[0, :, :3].T @ poses[0, :, 3]
    lengths = np.linalg.norm(first, axis=1)
    far = int(np.argmax(lengths))
    along = np.zeros(len(matrix))
    along[6 * far : 6 * far + 3] = first[far] / max(lengths[far], 1e-12)
    matrix += np.outer(along, along) * matrix[6 * far, 6 * far]


def _add_zoom_prior(
    matrix: np.ndarray, gradient: np.ndarray, zoom: np.ndarray, frames: Sequence[int]
) -> None:
    """Add a prior to normal equations: the zoom per frame hardly changes; jumps weigh less."""
    count, change, deviation = len(frames), _zoom_differences(frames), CALIBRATION.zoom_change
    weight = 1 / (1 + (change @ zoom / deviation) ** 2) / deviation**2
    weighted = change.T * weight
    part = slice(6 * count, 7 * count)
    matrix[part, part] += weighted @ change
    gradient[part] += weighted @ (change @ zoom)


def _zoom_differences(frames: Sequence[int]) -> np.ndarray:
    """Return a matrix, (F − 2, F): the changes of the zoom per frame, by the zooms of frames."""
    count, steps = len(frames), np.diff(np.array(frames, np.float64))
    change = np.zeros((max(count - 2, 0), count))
    for k in range(count - 2):
        change[k, k : k + 3] = 1 / steps[k], -1 / steps[k] - 1 / steps[k + 1], 1 / steps[k + 1]
    return change


def _total_cost(
    bundle: TrackBundle, state: _State, linear: _Linear, scale: float, deviation: float
) -> float:
    """Return the cost that a step lowers, px²: of the residuals, and of the prior of the zoom.

    The deviation of a coordinate, px, gives the prior the unit of the residuals.
    """
    change = _zoom_differences(bundle.frames) @ (state.zoom + state.removed_zoom)
    prior = np.log1p((change / CALIBRATION.zoom_change) ** 2).sum()
    return float(_costs(linear.residuals, scale).sum() + deviation**2 * prior)


def _minimise(
    bundle: TrackBundle, state: _State, is_free: np.ndarray, scale: float, steps: int
) -> _State:
    """Return the state after damped Gauss–Newton steps (Levenberg and Marquardt).

    The steps end where numbers are too large: a point lies beside a camera, far from its axis.
    """
    damping = CALIBRATION.bundle_damping
    linear = _linearise(bundle, state)
    for _ in range(steps):
        deviation = linear.weighting_deviation
        cost = _total_cost(bundle, state, linear, scale, deviation)
        reduced = _reduce(bundle, state, linear, is_free, scale, damping)
        if not np.isfinite(reduced.matrix).all():
            break
        step = np.zeros(len(is_free))
        step[is_free] = -np.linalg.lstsq(reduced.matrix, reduced.gradient, rcond=None)[0]
        candidate = state.moved(step, reduced.point_step(step[is_free]))
        new_linear = _linearise(bundle, candidate)
        new_cost = _total_cost(bundle, candidate, new_linear, scale, deviation)
        if not new_cost < cost:
            damping *= 10
            continue
        is_done = cost - new_cost < CALIBRATION.bundle_tolerance * cost
        state, linear, damping = candidate, new_linear, damping / 10
        if is_done:
            break
    return state
