"""Choice of the neighbour frames that give the depth of a keyframe."""

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.geometry.rays import pinhole_rays


def choose_neighbours(
    # (N, 4, 4) float64: camera to world. A frame without a pose has NaN and is never chosen.
    poses: np.ndarray,
    key: int,  # number of the keyframe
    # (H, W) array or float: a rough inverse depth of the keyframe, 1/unit of the poses. The median
    # replaces values that are not finite or not positive.
    inverse_depth: np.ndarray | float,
    camera: Camera,  # a pinhole
    shape: tuple[int, int],  # height and width of the frames, px
    *,
    max_count: int = 4,  # largest number of chosen frames
    # Height and width of the uncropped frames, px, if the frames are crops. Parallax is a share of
    # this width.
    uncropped_shape: tuple[int, int] | None = None,
) -> list[int]:  # numbers of the chosen frames, the best first
    """Choose frames with good parallax for each part of a keyframe, from both sides.

    The value of a frame for a point is s = min(1, p/p₁) min(1, p₂/p) min(1, c₁/c)², where p is the
    parallax of the point (`DEPTH.full_parallax`, `DEPTH.max_parallax`), and c the logarithm of the
    ratio of its distances from the two cameras (`DEPTH.max_distance_ratio`): a surface that comes
    much nearer, or goes away, looks different. Outside the frame, s is 0.

    Frames are chosen greedily: each time the frame that adds most to the weighted mean of log(1 +
    S/s₀) / log(1 + 1/s₀), with s₀ = `DEPTH.small_value`, over all points and both sides. S is the
    sum of s over the chosen frames in which the point moves to one side along its epipolar line.
    The sides have separate sums, since a surface that is hidden from one side may be visible from
    the other side. The logarithm makes the relative errors of near and far points count alike: on a
    drive, the far points that fill most of the frame would otherwise choose frames that show no
    near point.

    The rough depth may come from far points around a near surface without texture, such as a road.
    So each point counts twice: at its rough depth, and with less weight at a nearer depth.

    Raises ValueError if the keyframe has no pose or no known depth.
    """
    poses = np.asarray(poses, np.float64)
    if not np.isfinite(poses[key]).all():
        raise InputError(f"poses[{key}] is not finite: expected a pose of the keyframe")
    rays, inverse_depths, weights = _grid_points(inverse_depth, camera, shape)
    has_pose = np.isfinite(poses).all(axis=(1, 2))
    has_pose[key] = False
    candidates = np.flatnonzero(has_pose)
    values, directions = _parallax_values(
        poses, key, candidates, rays, inverse_depths, camera, shape, (uncropped_shape or shape)[1]
    )
    chosen: list[int] = []
    sums = np.zeros((2, rays.shape[1]))
    reference = None
    for _ in range(min(max_count, len(candidates))):
        same_side = np.ones(values.shape, bool)
        if reference is not None:
            same_side = np.einsum("jkp,kp->jp", directions, reference) >= 0
        gains = np.zeros(len(candidates))
        for is_same, side_sums in zip((same_side, ~same_side), sums, strict=True):
            benefits = _benefit(side_sums + values * is_same) - _benefit(side_sums)
            gains += (weights * benefits).sum(axis=1)
        gains[chosen] = 0
        best = int(np.argmax(gains))
        if gains[best] < DEPTH.min_gain:
            break
        for is_same, side_sums in zip((same_side, ~same_side), sums, strict=True):
            side_sums += values[best] * is_same[best]
        if reference is None:
            reference = directions[best].copy()
        has_no_reference = ~reference.any(axis=0)
        reference[:, has_no_reference] = directions[best][:, has_no_reference]
        chosen.append(best)
    return [int(candidates[j]) for j in chosen]


def _benefit(value: np.ndarray) -> np.ndarray:
    """Return the benefit of the summed value of frames; 0 for no value, 1 for a value of 1."""
    return np.log1p(value / DEPTH.small_value) / np.log1p(1 / DEPTH.small_value)


def _grid_points(
    inverse_depth: np.ndarray | float, camera: Camera, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rays (3, P) of a grid of image points at two depths, inverse depths, weights (P,).

    The sum of the weights is 1.
    """
    rows, columns = (
        ((np.arange(count) + 0.5) * length / count - 0.5)
        for count, length in zip(DEPTH.parallax_grid, shape, strict=True)
    )
    depth_map = np.broadcast_to(np.asarray(inverse_depth, np.float64), shape)
    inverse_depths = depth_map[np.ix_(rows.astype(int), columns.astype(int))].ravel()
    valid = np.isfinite(inverse_depths) & (inverse_depths > 0)
    if not valid.any():
        raise InputError("inverse_depth is nowhere positive: expected a rough depth of the frame")
    inverse_depths = np.where(valid, inverse_depths, np.median(inverse_depths[valid]))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = np.tile(pinhole_rays(points, camera, shape).T, 2)
    shares = np.repeat([1 - DEPTH.nearer_weight, DEPTH.nearer_weight], len(points))
    nearer = DEPTH.nearer_factor * inverse_depths
    return rays, np.concatenate([inverse_depths, nearer]), shares / len(points)


def _parallax_values(
    poses: np.ndarray,
    key: int,
    candidates: np.ndarray,  # (J,): numbers of the frames
    rays: np.ndarray,  # (3, P)
    inverse_depths: np.ndarray,  # (P,)
    camera: Camera,
    shape: tuple[int, int],
    uncropped_width: int,  # px
) -> tuple[np.ndarray, np.ndarray]:
    """Return how well candidates show points (J, P), and the directions of parallax (J, 2, P).

    Parallax is a share of `uncropped_width`.
    """
    height, width = shape
    cx, cy = camera.center_for(height, width)
    motions = np.linalg.inv(poses[candidates]) @ poses[key]
    rotated_rays = motions[:, :3, :3] @ rays
    points = rotated_rays + inverse_depths * motions[:, :3, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        positions = camera.focal * points[:, :2] / points[:, 2:]
        displacement = positions - camera.focal * rotated_rays[:, :2] / rotated_rays[:, 2:]
        distance_ratios = np.linalg.norm(points, axis=1) / np.linalg.norm(rays, axis=0)
        u, v = cx + positions[:, 0], cy + positions[:, 1]
        is_inside = (points[:, 2] > 0) & (rotated_rays[:, 2] > 0)
        is_inside &= (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    displacement = np.where(is_inside[:, None], displacement, 0)
    parallax = np.hypot(displacement[:, 0], displacement[:, 1]) / uncropped_width
    change = np.abs(np.log(np.where(is_inside, distance_ratios, 1)))
    values = np.minimum(1, parallax / DEPTH.full_parallax)
    values *= np.minimum(1, DEPTH.max_parallax / np.maximum(parallax, 1e-9))
    values *= np.minimum(1, np.log(DEPTH.max_distance_ratio) / np.maximum(change, 1e-9)) ** 2
    direction = displacement / np.maximum(uncropped_width * parallax, 1e-9)[:, None]
    return values * is_inside, direction
