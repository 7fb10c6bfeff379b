"""Choice of the frames from which the depth of a keyframe is found."""

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError

# Values without a stated source were set by hand.

# Rows and columns of the grid of image points whose parallax is computed.
GRID = (9, 12)
# Parallax, as a share of the image width, beyond which a frame gets no better.
FULL_PARALLAX = 0.03
# Parallax, as a share of the image width, beyond which windows look less and less alike.
MAX_PARALLAX = 0.12
# A frame whose mean gain over the grid points is smaller is not added. The gain of a point that no
# chosen frame shows yet is 1 at most.
MIN_GAIN = 0.03


def choose_neighbours(
    # (N, 4, 4) float64: camera to world. A frame without a pose has NaN and is never chosen.
    poses: np.ndarray,
    key: int,  # number of the keyframe
    # (h, w) array or float: a rough inverse depth of the keyframe, 1/unit of the poses. Where it is
    # not finite or not positive it is unknown; the median takes its place.
    inverse_depth: np.ndarray | float,
    camera: Camera,  # a pinhole
    shape: tuple[int, int],  # height and width of the frames, px
    *,
    most: int = 4,  # largest number of chosen frames
    # Height and width of the uncropped frames, px, if the frames are crops. Parallax is a share of
    # this width.
    whole: tuple[int, int] | None = None,
) -> list[int]:  # numbers of the chosen frames, the best first
    """Choose frames with good parallax for each part of a keyframe, from both sides.

    A frame shows a point with the value s = min(1, p/p₁) min(1, p₂/p), where p is the parallax of
    the point; s is 0 outside the frame. Frames are chosen greedily: each time the frame that adds
    most to Σ √S over all points. S is the sum of s over the chosen frames, taken apart for the
    frames in which the point moves to either side along its epipolar line: a surface that is hidden
    from one side may be visible from the other.

    Raises ValueError if the keyframe has no pose or no known depth.
    """
    poses = np.asarray(poses, np.float64)
    if not np.isfinite(poses[key]).all():
        raise InputError(f"poses[{key}] is not finite: expected a pose of the keyframe")
    rays, depth = _points(inverse_depth, camera, shape)
    known = np.isfinite(poses).all(axis=(1, 2))
    known[key] = False
    candidates = np.flatnonzero(known)
    shown, side = _shown(poses, key, candidates, rays, depth, camera, shape, (whole or shape)[1])
    chosen: list[int] = []
    sums = np.zeros((2, rays.shape[1]))
    reference = None
    for _ in range(min(most, len(candidates))):
        ahead = np.ones(shown.shape, bool)
        if reference is not None:
            ahead = np.einsum("jkp,kp->jp", side, reference) >= 0
        gains = np.zeros(len(candidates))
        for same, total in zip((ahead, ~ahead), sums, strict=True):
            gains += (np.sqrt(total + shown * same) - np.sqrt(total)).mean(axis=1)
        gains[chosen] = 0
        best = int(np.argmax(gains))
        if gains[best] < MIN_GAIN:
            break
        for same, total in zip((ahead, ~ahead), sums, strict=True):
            total += shown[best] * same[best]
        if reference is None:
            reference = side[best].copy()
        unset = ~reference.any(axis=0)
        reference[:, unset] = side[best][:, unset]
        chosen.append(best)
    return [int(candidates[j]) for j in chosen]


def _points(
    inverse_depth: np.ndarray | float, camera: Camera, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays (3, P) of a grid of image points, and their inverse depth (P,)."""
    height, width = shape
    cx, cy = camera.center_for(height, width)
    rows, columns = (
        ((np.arange(count) + 0.5) * side / count - 0.5)
        for count, side in zip(GRID, shape, strict=True)
    )
    values = np.broadcast_to(np.asarray(inverse_depth, np.float64), shape)
    near = values[np.ix_(rows.astype(int), columns.astype(int))].ravel()
    known = np.isfinite(near) & (near > 0)
    if not known.any():
        raise InputError("inverse_depth is nowhere positive: expected a rough depth of the frame")
    near = np.where(known, near, np.median(near[known]))
    x, y = np.meshgrid((columns - cx) / camera.focal, (rows - cy) / camera.focal)
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)]), near


def _shown(
    poses: np.ndarray,
    key: int,
    candidates: np.ndarray,
    rays: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    shape: tuple[int, int],
    full: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return how well candidates show points (J, P), and the directions of parallax (J, 2, P).

    Parallax is a share of `full`, an image width in px.
    """
    height, width = shape
    cx, cy = camera.center_for(height, width)
    motions = np.linalg.inv(poses[candidates]) @ poses[key]
    turned = motions[:, :3, :3] @ rays
    moved = turned + depth * motions[:, :3, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        there = camera.focal * moved[:, :2] / moved[:, 2:]
        apart = there - camera.focal * turned[:, :2] / turned[:, 2:]
        u, v = cx + there[:, 0], cy + there[:, 1]
        inside = (moved[:, 2] > 0) & (turned[:, 2] > 0)
        inside &= (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    apart = np.where(inside[:, None], apart, 0)
    parallax = np.hypot(apart[:, 0], apart[:, 1]) / full
    shown = np.minimum(1, parallax / FULL_PARALLAX) * np.minimum(
        1, MAX_PARALLAX / np.maximum(parallax, 1e-9)
    )
    direction = apart / np.maximum(full * parallax, 1e-9)[:, None]
    return shown * inside, direction
