"""Poses of a camera before a single plane, aligned to the grey levels of all pixels.

Frames of a plane differ by homographies. The homographies of many pairs of frames are measured on
all pixels.
Poses and the normal of the plane are then fitted to them. Tracks are less exact: they follow a few
hundred points, and drift.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, identity
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from tisfm.camera import Camera
from tisfm.motion.epipolar_fit import MAD_TO_DEVIATION
from tisfm.reconstruction.depth.plane_homographies import HomographySearch, MeasuredHomography
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.mapping.plane_motion import fit_plane
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import TrackPoints

DERIVATIVE_STEP = 1e-6  # rad, and share of the plane's distance: of numerical derivatives


@dataclass(frozen=True, kw_only=True, eq=False)
class _TrackPair:
    """Tracks that two frames share."""

    first: int  # index of the frame
    second: int
    start: np.ndarray  # (N, 2) float64: positions in the first frame, in focal lengths
    end: np.ndarray  # (N, 2) float64: in the second frame


@dataclass(frozen=True, kw_only=True, eq=False)
class _PlanePath:
    """Poses, and a plane at distance 1, in the axes of the first camera."""

    poses: np.ndarray  # (F, 3, 4) float64: world to camera; the first is fixed
    normal: np.ndarray  # (3,) float64: n · X = 1 on the plane

    def moved(self, motion: np.ndarray, tilt: np.ndarray) -> "_PlanePath":
        """Return the path after a step of the poses, (F, 6) as (t, ω), and of the normal, (2,)."""
        return _PlanePath(poses=_move(self.poses, motion), normal=_tilt(self.normal, tilt))


def align_plane(
    poses: Mapping[int, np.ndarray],  # by frame, in order: (4, 4), camera to world
    points: Mapping[int, np.ndarray],  # by track: (3,), in the world
    observations: Sequence[Observations],  # tracks in every frame
    # frame → (H, W) float32: grey levels; frame → (H, W) bool: pixels that are used
    grey: Callable[[int], np.ndarray],
    used_pixels: Callable[[int], np.ndarray],
    camera: Camera,  # a pinhole
    shape: tuple[int, int],  # height and width of the frames, px
) -> dict[int, np.ndarray] | None:
    """Return aligned poses, by frame; None if the points do not all lie on one plane.

    It is None as well if few frames share tracks: only tracks show relief.
    """
    frames = list(poses)
    if len(frames) < MAPPING.min_views:
        return None
    origin = poses[frames[0]]
    to_first = np.linalg.inv(origin)
    known = points if isinstance(points, TrackPoints) else TrackPoints.from_mapping(points)
    plane = fit_plane(known.positions @ to_first[:3, :3].T + to_first[:3, 3])
    if plane is None:
        return None
    distance = 1 / float(np.linalg.norm(plane))
    relative = np.array([np.linalg.solve(poses[frame], origin)[:3] for frame in frames])
    relative[:, :, 3] /= distance
    path = _PlanePath(poses=relative, normal=plane * distance)
    tracks = [observations[frame] for frame in frames]
    pairs = _pair_tracks(tracks, camera, shape)
    if pairs is None:
        return None
    distances = _measure_tracks(path, pairs, camera.focal)
    if _shows_relief(distances):
        return None
    measured = _measure_pairs(path, frames, HomographySearch(grey, used_pixels, camera))
    if set(range(len(frames))) - {k for pair in measured for k in (pair.first, pair.second)}:
        return None  # a frame without a measured homography
    path = _fit(path, measured)
    new_distances = _measure_tracks(path, pairs, camera.focal)
    if not np.median(new_distances) <= DEPTH.max_track_growth * np.median(distances):
        return None  # the images fit another motion than the tracks: they show more than the plane
    aligned = np.tile(np.eye(4), (len(frames), 1, 1))
    aligned[:, :3] = path.poses
    aligned[:, :3, 3] *= distance
    return dict(zip(frames, origin @ np.linalg.inv(aligned), strict=True))


def _measure_pairs(
    path: _PlanePath, frames: Sequence[int], search: HomographySearch
) -> list[MeasuredHomography]:
    pairs = [
        (second - gap, second)
        for second in range(len(frames))
        for gap in sorted(DEPTH.plane_gaps, reverse=True)
        if gap <= second
    ]
    first, second = np.array(pairs).T
    starts = _find_homographies(path.poses[first], path.poses[second], path.normal)
    found = [
        search.measure(pair, (frames[pair[0]], frames[pair[1]]), start)
        for pair, start in zip(pairs, starts, strict=True)
    ]
    return [each for each in found if each is not None]


def _fit(path: _PlanePath, measured: Sequence[MeasuredHomography]) -> _PlanePath:
    """Return the path that fits measured homographies best."""
    equations = _Equations(measured)
    residual = equations.residuals(path)
    for _ in range(DEPTH.plane_rounds):
        motion, tilt = equations.find_step(path, residual)
        candidate = path.moved(motion, tilt)
        new = equations.residuals(candidate)
        if not (new**2).sum() < (residual**2).sum():
            break
        path, residual = candidate, new
        if np.abs(motion).max() < DEPTH.min_plane_step:
            break
    return path


class _Equations:
    """Residuals of measured homographies, and the steps that lower them."""

    def __init__(self, measured: Sequence[MeasuredHomography]) -> None:
        self._first = np.array([each.first for each in measured])
        self._second = np.array([each.second for each in measured])
        self._inverse = np.linalg.inv([each.matrix for each in measured])
        self._roots = np.array([np.linalg.cholesky(each.information).T for each in measured])

    def residuals(self, path: _PlanePath) -> np.ndarray:
        """Return the residuals, (P, 8), in deviations."""
        return self._residuals(path.poses[self._first], path.poses[self._second], path.normal)

    def find_step(self, path: _PlanePath, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a Gauss–Newton step: motions of all frames, (F, 6), and the tilt, (2,)."""
        count = len(path.poses)
        before, after = path.poses[self._first], path.poses[self._second]
        changed, columns = [], []
        for step in np.eye(6) * DERIVATIVE_STEP:
            changed.append(self._residuals(_move(before, step[None]), after, path.normal))
            changed.append(self._residuals(before, _move(after, step[None]), path.normal))
            k = int(step.argmax())
            columns += [6 * self._first + k, 6 * self._second + k]
        for step in np.eye(2) * DERIVATIVE_STEP:
            changed.append(self._residuals(before, after, _tilt(path.normal, step)))
            columns.append(np.full(len(residual), 6 * count + int(step.argmax())))
        derivatives = (np.array(changed) - residual) / DERIVATIVE_STEP  # (14, P, 8)
        rows = np.broadcast_to(np.arange(residual.size).reshape(residual.shape), derivatives.shape)
        places = np.broadcast_to(np.array(columns)[:, :, None], derivatives.shape)
        jacobian = coo_matrix(
            (derivatives.ravel(), (rows.ravel(), places.ravel())),
            shape=(residual.size, 6 * count + 2),
        ).tocsc()[:, 6:]  # the first frame does not move
        matrix = (jacobian.T @ jacobian).tocsc()
        damping = DEPTH.plane_damping * matrix.diagonal().max()
        step = -spsolve(
            matrix + damping * identity(matrix.shape[0], format="csc"),
            jacobian.T @ residual.ravel(),
        )
        return np.r_[np.zeros(6), step[:-2]].reshape(-1, 6), step[-2:]

    def _residuals(self, before: np.ndarray, after: np.ndarray, normal: np.ndarray) -> np.ndarray:
        rest = self._inverse @ _find_homographies(before, after, normal)
        rest = rest / rest[:, 2:, 2:] - np.eye(3)
        return np.einsum("nij,nj->ni", self._roots, rest.reshape(-1, 9)[:, :8])


def _find_homographies(before: np.ndarray, after: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the homographies, (P, 3, 3), of the plane n · X = 1 between poses, (P, 3, 4)."""
    turn = after[:, :, :3] @ before[:, :, :3].transpose(0, 2, 1)
    shift = after[:, :, 3] - np.einsum("nij,nj->ni", turn, before[:, :, 3])
    plane = before[:, :, :3] @ normal
    plane /= 1 + (plane * before[:, :, 3]).sum(axis=1, keepdims=True)
    return np.asarray(turn + shift[:, :, None] * plane[:, None, :])


def _move(poses: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return poses, (P, 3, 4), after motions (t, ω), (P, 6) or (1, 6), of the camera's axes."""
    moved = np.asarray(Rotation.from_rotvec(motion[:, 3:]).as_matrix() @ poses)
    moved[:, :, 3] += motion[:, :3]
    return moved


def _tilt(normal: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Return a unit normal after a step across it, (2,)."""
    tilted = normal + tilt @ np.linalg.svd(normal[None])[2][1:]
    return np.asarray(tilted / np.linalg.norm(tilted))


def _pair_tracks(
    observations: Sequence[Observations], camera: Camera, shape: tuple[int, int]
) -> list[_TrackPair] | None:
    """Return the tracks of each frame and of the farthest frame before it that shares enough.

    None is returned if too many frames share too few tracks with the frames before them.
    """
    center = np.array(camera.center_for(*shape))
    pairs = []
    for second, seen in enumerate(observations):
        enough, best = DEPTH.min_relief_tracks, None
        for gap in range(1, min(DEPTH.relief_gap, second) + 1):
            common = observations[second - gap].common_tracks(seen)
            if gap == 1:
                enough = max(enough, round(DEPTH.min_relief_track_share * len(common[0])))
            if len(common[0]) < enough:
                break
            best = second - gap, *common
        if best is not None:
            first, rows, others = best
            start, end = observations[first].points[rows], seen.points[others]
            start, end = ((points - center) / camera.focal for points in (start, end))
            pairs.append(_TrackPair(first=first, second=second, start=start, end=end))
    if len(pairs) < DEPTH.min_relief_frames * (len(observations) - 1):
        return None
    return pairs


def _measure_tracks(path: _PlanePath, pairs: Sequence[_TrackPair], focal: float) -> np.ndarray:
    """Return the distances, (2, N) px, of tracks from their positions on the plane.

    The distances are along and across the epipolar lines.
    """
    along, across = [], []
    for pair in pairs:
        before, after = path.poses[[pair.first]], path.poses[[pair.second]]
        (homography,) = _find_homographies(before, after, path.normal)
        moved = np.column_stack([pair.start, np.ones(len(pair.start))]) @ homography.T
        on_plane = moved[:, :2] / moved[:, 2:]
        turn = after[0, :, :3] @ before[0, :, :3].T
        shift = after[0, :, 3] - turn @ before[0, :, 3]
        lines = shift[:2] - on_plane * shift[2]
        lines /= np.maximum(np.linalg.norm(lines, axis=1, keepdims=True), 1e-12)
        rest = focal * (pair.end - on_plane)
        along.append((rest * lines).sum(axis=1))
        across.append(rest[:, 0] * lines[:, 1] - rest[:, 1] * lines[:, 0])
    return np.abs([np.concatenate(along), np.concatenate(across)])


def _shows_relief(distances: np.ndarray) -> bool:
    """Return whether tracks leave the plane along epipolar lines more than across them.

    Errors of tracks have no direction, and relief is along the lines.
    """
    deviation = max(MAD_TO_DEVIATION * float(np.median(distances[1])), DEPTH.min_track_deviation)
    shares = (distances > DEPTH.relief_deviations * deviation).mean(axis=1)
    return bool(shares[0] - shares[1] > DEPTH.max_relief_share)
