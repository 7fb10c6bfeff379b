"""Points of tracks under known poses."""

from collections.abc import Mapping, Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.tracks import Seen

FEWEST = 2  # frames that see a track
LEAST_ANGLE = 0.5  # degrees between the rays of a track that says anything of its depth
INLIER = 3.0  # px: the median of a track's residuals


def triangulated(
    seen: Sequence[Seen],
    poses: Mapping[int, np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
) -> dict[int, np.ndarray]:
    """Return the points of tracks, (3,) float64 by track, nearest to all rays that see them.

    Parameters
    ----------
    seen : sequence of Seen
        Of every frame.
    poses : mapping of int to (4, 4) array
        Camera to world, by frame.
    camera : Camera
        A pinhole.
    shape : (int, int)
        Height and width of the frames, px.
    """
    cx, cy = camera.center_for(*shape)
    tracks, centres, rays, places, frames = [], [], [], [], []
    for frame, pose in poses.items():
        points = seen[frame].points
        ray = np.column_stack([(points - (cx, cy)) / camera.focal, np.ones(len(points))])
        ray = ray @ pose[:3, :3].T
        tracks.append(seen[frame].tracks)
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
        centres.append(np.broadcast_to(pose[:3, 3], ray.shape))
        places.append(points)
        frames.append(np.full(len(points), frame))
    if not tracks:
        return {}
    numbers, index = np.unique(np.concatenate(tracks), return_inverse=True)
    ray, centre, place, frame_of = map(np.concatenate, (rays, centres, places, frames))
    count = np.bincount(index)
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    matrix, vector = np.zeros((len(numbers), 3, 3)), np.zeros((len(numbers), 3))
    mean = np.zeros((len(numbers), 3))
    np.add.at(matrix, index, across)
    np.add.at(vector, index, np.einsum("nkl,nl->nk", across, centre))
    np.add.at(mean, index, ray)
    # Where rays are parallel, the least eigenvalue vanishes: count · sin² of their spread.
    least = np.linalg.eigvalsh(matrix)[:, 0]
    good = (count >= FEWEST) & (least > count * np.sin(np.radians(LEAST_ANGLE) / 2) ** 2)
    point = np.zeros((len(numbers), 3))
    point[good] = np.linalg.solve(matrix[good], vector[good][..., None])[..., 0]
    residual = np.full(len(index), np.inf)
    for frame, pose in poses.items():
        mine = frame_of == frame
        local = (point[index[mine]] - pose[:3, 3]) @ pose[:3, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            there = local[:, :2] / local[:, 2:] * camera.focal + (cx, cy)
        off = np.hypot(*(there - place[mine]).T)
        residual[mine] = np.where(local[:, 2] > 0, np.nan_to_num(off, nan=np.inf), np.inf)
    order = np.lexsort((residual, index))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    good &= residual[order][first + (count - 1) // 2] < INLIER
    return dict(zip(numbers[good].tolist(), point[good], strict=True))


def depths_of(
    seen: Seen, points: Mapping[int, np.ndarray], pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of a frame's tracks whose points lie before it, (N, 2), and their Z."""
    known = [k for k, track in enumerate(seen.tracks.tolist()) if track in points]
    world = np.array([points[track] for track in seen.tracks[known].tolist()]).reshape(-1, 3)
    depth = (world - pose[:3, 3]) @ pose[:3, 2]
    return seen.points[known][depth > 0], depth[depth > 0]
