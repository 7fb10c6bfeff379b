"""Films of a rendered room with exact truth, and the errors of their reconstructions."""

import hashlib
import itertools
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

import tisfm
from tisfm.camera import Camera
from tisfm.metrics import absolute_errors, align, path_length
from tisfm.reconstruction.depth.window_depth import window_depth
from tisfm.rigid import pose_matrix
from tisfm.scenes import Film, room_film

SIZE = 240, 320  # px, height and width
CACHE = Path(tempfile.gettempdir()) / "tisfm-rendered-films"
COUNTS = (2, 3, 4, 6, 8)  # numbers of frames for the depth of a keyframe
MAX_VERTEX_ERROR = 0.02  # share of the true depth: largest error of a correct vertex
MIN_HIDDEN_DISTANCE = 0.05  # share of the visible depth: points farther behind are hidden

Poses = np.ndarray  # (N, 4, 4), camera to world


@dataclass(frozen=True, kw_only=True)
class FilmParameters:
    """Parameters of a rendered film."""

    name: str
    poses: np.ndarray  # (N, 4, 4), camera to world, m
    textured: bool  # whether the room's walls have a pattern
    seed: int = 0
    height: int = SIZE[0]  # px
    width: int = SIZE[1]  # px
    readout: float = 0.0  # readout time of the rolling shutter, as for `tisfm.Camera`

    def film(self) -> Film:
        """Return the film; rendered films are kept in a temporary folder."""
        words = repr(sorted((asdict(self) | {"poses": self.poses.tobytes()}).items()))
        path = CACHE / f"{hashlib.sha256(words.encode()).hexdigest()[:16]}.npz"
        if path.exists():
            with np.load(path) as stored:
                camera = Camera(focal=float(stored["focal"]))
                return Film(
                    frames=stored["frames"], depth=stored["depth"], poses=self.poses, camera=camera
                )
        film = room_film(
            self.poses,
            self.height,
            self.width,
            seed=self.seed,
            textured=self.textured,
            samples=2,
            readout=self.readout,
        )
        CACHE.mkdir(exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez(part, frames=film.frames, depth=film.depth, focal=film.camera.focal)
        part.replace(path)
        return film


def walk_path(count: int) -> np.ndarray:
    """Return the poses of a camera that moves sideways and forward, and turns slightly."""
    return np.array([pose_matrix((0.04 * k, 0, 0.02 * k, 0, 0.01 * k, 0)) for k in range(count)])


def round_trip_path(count: int) -> np.ndarray:
    """Return the poses of a camera that circles in the room and ends at its first position.

    It looks at one corner of the room, and to the left and right of the corner.
    """
    phase = np.linspace(0, 2 * np.pi, count)
    positions = np.stack(
        [0.6 * np.sin(phase), 0.08 * np.sin(2 * phase), 0.5 * (1 - np.cos(phase))], axis=1
    )
    return _horizontal_poses(positions, 0.35 * np.sin(phase))


def circle_path(count: int, of_round: int = 225) -> np.ndarray:
    """Return the poses of a camera that circles repeatedly and looks outward.

    Rounds have different radii and heights.
    """
    phase = 2 * np.pi * np.arange(count) / of_round
    radius = 0.7 + 0.15 * np.sin(phase / 3.1)
    height = 0.2 * np.sin(phase / 4.3)
    return _horizontal_poses(
        np.stack([radius * np.sin(phase), height, radius * np.cos(phase)], axis=1), phase
    )


def turn_path(before: int, turning: int, after: int, step: float = 0.02) -> np.ndarray:
    """Return the poses of a camera that moves, turns on the spot, and moves on; step in rad."""
    motion_per_frame = np.array([0.035, 0, 0.02])
    shift = np.r_[np.arange(before), np.full(turning, before - 1), before + np.arange(after)]
    angle = np.r_[np.zeros(before), 1 + np.arange(turning), np.full(after, turning)] * step
    return _horizontal_poses(
        (shift - shift[0])[:, None] * motion_per_frame, angle - step * turning / 2
    )


def shake_path(count: int) -> np.ndarray:
    """Return the poses of a moving camera that shakes by up to 3° between frames."""
    phase = np.arange(count)
    turns = 0.03 * np.sin(0.9 * phase), 0.04 * (np.cos(0.7 * phase) - 1), 0.02 * np.sin(1.3 * phase)
    twists = np.stack([0.04 * phase, 0.01 * np.sin(phase), 0.02 * phase, *turns], axis=1)
    return np.array([pose_matrix(twist) for twist in twists])


def keyframe_path(count: int) -> np.ndarray:
    """Return the poses of a keyframe, and of frames on both sides at growing distances."""
    factors = [0, *(sign * k for k in range(1, count) for sign in (1, -1))][:count]
    motion = np.array([0.12, 0.0, 0.08, 0.003, 0.01, 0.006])
    return np.array([pose_matrix(factor * motion) for factor in factors])


def _horizontal_poses(positions: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the poses of a camera at positions, (N, 3), turned right by angles, (N,) rad."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    for pose, position, angle in zip(poses, positions, angles, strict=True):
        pose[:3, :3] = cv2.Rodrigues(np.array([0.0, angle, 0.0]))[0]
        pose[:3, 3] = position
    return poses


def centres(poses: Poses) -> np.ndarray:  # of the cameras, (N, 3)
    return np.asarray(poses[:, :3, 3])


def poses_of_segment(result: tisfm.Reconstruction, segment: int = 0) -> Poses:
    """Return the poses of one segment; the other poses are NaN."""
    return np.where((result.piece == segment)[:, None, None], result.poses, np.nan)


def path_error(poses: Poses, true: Poses) -> float:
    """Return the ATE of the frames with a pose, % of the true path; NaN with fewer than two."""
    is_known = np.isfinite(poses[:, 0, 0])
    if is_known.sum() < 2:
        return float("nan")
    return 100 * absolute_errors(poses[is_known], true[is_known]).similarity / path_length(true)


def end_gap(poses: Poses, true: Poses) -> float:
    """Return the error of the last position relative to the first pose, % of the true path.

    The whole path has one scale.
    """
    alignment = align(centres(poses), centres(true))
    last_positions = alignment.scale * _from_first(poses), _from_first(true)
    return 100 * float(np.linalg.norm(last_positions[0] - last_positions[1])) / path_length(true)


def scale_change(poses: Poses, true: Poses, before: slice, after: slice) -> float:
    """Return the difference between the scales of two parts of a path, %."""
    scale_before, scale_after = (
        align(centres(poses[part]), centres(true[part])).scale for part in (before, after)
    )
    return 100 * abs(scale_after / scale_before - 1)


def flicker(film: Film, result: tisfm.Reconstruction, settings: tisfm.Settings) -> float:
    """Return the spread of the scale of depth over frames, divided by the spread of single pairs.

    Pairs without depth are left out.
    """
    numbers = range(0, len(film.frames) - 1, 3)
    spread = np.std([_log_scale(film.depth[k], result.depth(k)) for k in numbers])
    pairs = [
        tisfm.interpret(*film.frames[k : k + 2], camera=film.camera, settings=settings)
        for k in numbers
    ]
    pair_scales = [
        _log_scale(film.depth[k], pair.depth) for k, pair in zip(numbers, pairs, strict=True)
    ]
    return float(spread / np.nanstd(pair_scales))


def share_of_mesh(film: Film, result: tisfm.Reconstruction) -> float:
    """Return the share of the vertices of a mesh of the keyframes near the true surface, %.

    The mesh is aligned with the truth by the similarity of the paths alone.
    """
    vertices = result.mesh().vertices
    if not len(vertices):
        return 0.0
    aligned = align(centres(result.poses), centres(film.poses)).apply(vertices)
    return 100 * float(np.mean(_distance(aligned, film) < MAX_VERTEX_ERROR))


def depth_in_one_scale(film: Film, result: tisfm.Reconstruction) -> float:
    """Return the mean error of the depth of all frames in one scale; missing depth counts as 1."""
    depth = np.array([result.depth(k) for k in range(len(film.frames))])
    scale = np.nanmedian(film.depth / depth)
    error = np.abs(scale * depth - film.depth) / film.depth
    return float(np.nan_to_num(error, nan=1.0).mean())


def depth_of_window(film: Film, count: int, settings: tisfm.Settings) -> tuple[float, float]:
    """Return the mean error of the depth of the first frame from `count` frames with given poses.

    The second value is the share of pixels with an error of at most one deviation, %.
    """
    frames = film.frames[:count].astype(np.float32)
    motions = np.array([(np.linalg.inv(pose) @ film.poses[0])[:3] for pose in film.poses[1:count]])
    estimate = window_depth(frames[0], list(frames[1:]), motions, film.camera, settings)
    if estimate is None:
        return float("nan"), float("nan")
    error = np.abs(1 / estimate.inverse_depth - film.depth[0]) / film.depth[0]
    difference = np.abs(estimate.inverse_depth - 1 / film.depth[0])
    return float(error.mean()), 100 * float(np.mean(difference <= estimate.deviation))


def depth_of_pair(film: Film, settings: tisfm.Settings) -> float:
    """Return the mean error of the depth of the first frame from two frames, in its best scale."""
    depth = tisfm.interpret(*film.frames[:2], camera=film.camera, settings=settings).depth
    true = film.depth[0]
    scaled = depth * np.nanmedian(true / depth)
    return float(np.nan_to_num(np.abs(scaled - true) / true, nan=1.0).mean())


def _from_first(poses: Poses) -> np.ndarray:
    """Return the last position in the axes of the first camera, (3,)."""
    return np.asarray(poses[0, :3, :3].T @ (poses[-1, :3, 3] - poses[0, :3, 3]))


def _log_scale(true: np.ndarray, estimate: np.ndarray) -> float:
    is_known = np.isfinite(estimate)
    return (
        float(np.log(np.median(true[is_known] / estimate[is_known]))) if is_known.any() else np.nan
    )


def _distance(points: np.ndarray, film: Film) -> np.ndarray:
    """Return the relative distance of points, (N, 3), from the visible surface, (N,).

    It is a share of the depth, the mean over frames that do not hide the point; infinite if all do.
    """
    total, count = np.zeros((2, len(points)))
    height, width = film.depth.shape[1:]
    center = film.camera.center_for(height, width)
    for pose, depth in zip(film.poses, film.depth, strict=True):
        x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
        ahead = np.where(z > 0, z, 1)
        u, v = (film.camera.focal * a / ahead + c for a, c in zip((x, y), center, strict=True))
        pixels = np.flatnonzero((z > 0) & (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1))
        column, row = u[pixels].astype(np.intp), v[pixels].astype(np.intp)
        # At an edge, the nearest surface of four pixels counts.
        distances = np.stack(
            [
                z[pixels] / depth[row + j, column + i] - 1
                for i, j in itertools.product((0, 1), (0, 1))
            ]
        )
        nearest = np.take_along_axis(distances, np.abs(distances).argmin(axis=0)[None], axis=0)[0]
        is_visible = nearest < MIN_HIDDEN_DISTANCE
        total[pixels[is_visible]] += np.abs(nearest[is_visible])
        count[pixels[is_visible]] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.inf)
