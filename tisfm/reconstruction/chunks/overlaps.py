"""The similarity between two chunks, from the frames that both contain.

The rotation is the mean rotation between the poses of these frames. The scale comes from the depth
of their pixels, and from the camera positions. The scatter of each estimate gives its weight.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.reconstruction.chunks.settings import CHUNKING
from tisfm.reconstruction.geometry.sim3 import mean_rotation, transform_points
from tisfm.reconstruction.result.folder import depth_path
from tisfm.reconstruction.result.reconstruction import Reconstruction

Shared = Sequence[tuple[int, int]]
"""Shared frames: the numbers of each frame in the first and in the second result."""


@dataclass(frozen=True, kw_only=True)
class ChunkOverlap:
    """The similarity between a piece of a chunk and a piece of the next chunk."""

    # first, second: numbers of the pieces
    first: int
    second: int
    # (4, 4) float64: from the coordinates of the second piece to the coordinates of the first piece
    similarity: np.ndarray
    frames: int  # number of frames that both pieces share


def overlap_sim3(
    first: Reconstruction,
    second: Reconstruction,
    shared: Shared,  # shared frames with a pose in both results
) -> np.ndarray | None:
    """Return the similarity between two pieces; None if it is unknown.

    Returns (4, 4) float64, from the coordinates of the second result to the coordinates of the
    first result; or None.
    """
    poses, others = (
        result.poses[[pair[k] for pair in shared]] for k, result in enumerate((first, second))
    )
    rotation = mean_rotation(poses, others)
    first_frame, second_frame = shared[0]
    if not first.has_position[first_frame] and not second.has_position[second_frame]:
        # The camera only turns: positions are unknown, and so is the scale.
        similarity = np.eye(4)
        similarity[:3, :3] = rotation
        return similarity
    candidates = (
        scale_from_depth(first, second, shared),
        scale_from_positions(poses, others, rotation),
    )
    estimates = [estimate for estimate in candidates if estimate is not None]
    if not estimates:
        return None
    logs, deviations = np.array(estimates).T
    scale = np.exp(np.average(logs, weights=1 / deviations**2))
    similarity = np.eye(4)
    similarity[:3, :3] = scale * rotation
    similarity[:3, 3] = np.mean(poses[:, :3, 3] - others[:, :3, 3] @ (scale * rotation).T, axis=0)
    return similarity


def scale_from_positions(
    # poses, others: (N, 4, 4): camera to world, of the same frames in the first and second result
    poses: np.ndarray,
    others: np.ndarray,
    rotation: np.ndarray,  # (3, 3): from the axes of the second result to the first result
) -> tuple[float, float] | None:
    """Return the logarithm of the scale from camera positions, and its standard deviation."""
    if len(poses) < CHUNKING.min_positions:
        return None
    positions = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)
    other_positions = (others[:, :3, 3] - others[:, :3, 3].mean(axis=0)) @ rotation.T
    spread, other_spread = (
        float(np.sqrt((centered**2).sum())) for centered in (positions, other_positions)
    )
    if min(spread, other_spread) == 0:
        return None
    scale = spread / other_spread  # not a least-squares fit, since both chunks are equally exact
    deviation = max(
        float(np.linalg.norm(positions - scale * other_positions)) / spread,
        CHUNKING.min_scale_deviation,
    )
    return None if deviation > CHUNKING.max_scale_deviation else (float(np.log(scale)), deviation)


def scale_from_depth(
    first: Reconstruction, second: Reconstruction, shared: Shared
) -> tuple[float, float] | None:
    """Return the logarithm of the scale from depth, and its standard deviation."""
    ratio_sets = [
        _depth_ratios(first, second, shared, pair)
        for pair in _frames_with_depth(first, second, shared)
    ]
    ratio_sets = [frame_ratios for frame_ratios in ratio_sets if len(frame_ratios)]
    if not ratio_sets:
        return None
    ratios = np.log(np.concatenate(ratio_sets))
    if len(ratios) < CHUNKING.min_pixels:
        return None
    scale = float(np.median(ratios))
    if (
        np.mean(np.abs(ratios - scale) < CHUNKING.max_scale_difference)
        < CHUNKING.min_agreeing_share
    ):
        return None
    medians = np.array([np.median(np.log(frame_ratios)) for frame_ratios in ratio_sets])
    deviation = max(float(np.median(np.abs(medians - scale))), CHUNKING.min_scale_deviation)
    return None if deviation > CHUNKING.max_scale_deviation else (scale, deviation)


def _frames_with_depth(
    first: Reconstruction, second: Reconstruction, shared: Shared
) -> Iterator[tuple[int, int]]:
    """Yield frames with depth in the first result, and the nearest frame with depth in the second.

    Both are indices of `shared`.
    """
    firsts, seconds = (
        [k for k, pair in enumerate(shared) if depth_path(result.folder, pair[side]).exists()]
        for side, result in enumerate((first, second))
    )
    if not firsts or not seconds:
        return
    count = min(len(firsts), CHUNKING.max_frames)
    for k in np.unique(np.linspace(0, len(firsts) - 1, count).astype(int)):
        yield (
            firsts[k],
            min(seconds, key=lambda index: (abs(index - firsts[k]), index)),
        )


def _depth_ratios(
    first: Reconstruction, second: Reconstruction, shared: Shared, pair: tuple[int, int]
) -> np.ndarray:
    """Return the ratios of depth in the first result to depth in the second, for some pixels.

    `pair` has the indices in `shared` of a frame of each result. If the frames differ, the points
    of the first frame are projected into the second frame.
    """
    height, width = first.shape
    fx, fy = first.camera.focals
    cx, cy = first.camera.center_for(height, width)
    intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    frame, (first_frame, second_frame) = shared[pair[0]][0], shared[pair[1]]
    step = max(1, int(np.sqrt(height * width / CHUNKING.pixels_per_frame)))
    rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    rows, columns = rows.ravel(), columns.ravel()
    depth = _certain_depth(first, frame)[rows, columns]
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=1)
    points = depth[:, None] * (pixels @ np.linalg.inv(intrinsics).T)
    if frame != first_frame:
        points = transform_points(
            np.linalg.solve(first.poses[first_frame], first.poses[frame]), points
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            positions = (points @ intrinsics.T)[:, :2] / np.where(
                points[:, 2:] > 0, points[:, 2:], np.nan
            )
        columns, rows = np.rint(np.nan_to_num(positions, nan=-1.0).clip(-1, 1e6)).astype(int).T
    is_inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    ratio = (
        points[is_inside, 2]
        / _certain_depth(second, second_frame)[rows[is_inside], columns[is_inside]]
    )
    return np.asarray(ratio[np.isfinite(ratio)])


def _certain_depth(result: Reconstruction, frame: int) -> np.ndarray:
    """Return the depth of a frame, (H, W) float64; NaN where it is uncertain."""
    inverse_depth = result.inverse_depth(frame).astype(np.float64)
    with np.errstate(invalid="ignore"):
        is_certain = (inverse_depth > 0) & (
            result.inverse_depth_std(frame) < CHUNKING.max_depth_deviation * inverse_depth
        )
    return 1 / np.where(is_certain, inverse_depth, np.nan)
