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

    The value of a frame for a point is s = min(1, p/p₁) min(1, p₂/p), where p is the parallax of
    the point; s is 0 outside the frame. Frames are chosen greedily: each time the frame that adds
    most to Σ √S over all points and both sides. S is the sum of s over the chosen frames in which
    the point moves to one side along its epipolar line. The sides have separate sums, since a
    surface that is hidden from one side may be visible from the other side.

    Raises ValueError if the keyframe has no pose or no known depth.
    """
    poses = np.asarray(poses, np.float64)
    if not np.isfinite(poses[key]).all():
        raise InputError(f"poses[{key}] is not finite: expected a pose of the keyframe")
    rays, inverse_depths = _grid_points(inverse_depth, camera, shape)
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
            gains += (np.sqrt(side_sums + values * is_same) - np.sqrt(side_sums)).mean(axis=1)
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


def _grid_points(
    inverse_depth: np.ndarray | float, camera: Camera, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays (3, P) of a grid of image points, and their inverse depth (P,)."""
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
    return np.ascontiguousarray(pinhole_rays(points, camera, shape).T), inverse_depths


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
        u, v = cx + positions[:, 0], cy + positions[:, 1]
        is_inside = (points[:, 2] > 0) & (rotated_rays[:, 2] > 0)
        is_inside &= (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    displacement = np.where(is_inside[:, None], displacement, 0)
    parallax = np.hypot(displacement[:, 0], displacement[:, 1]) / uncropped_width
    values = np.minimum(1, parallax / DEPTH.full_parallax) * np.minimum(
        1, DEPTH.max_parallax / np.maximum(parallax, 1e-9)
    )
    direction = displacement / np.maximum(uncropped_width * parallax, 1e-9)[:, None]
    return values * is_inside, direction
